"""Generate and compile the Python package of an interface, against the ROS wheels of this environment.

The wheels carry headers, libraries and the generators of rosidl, so a C and a C++ compiler are all that is missing.
One shared library holds what an installation spreads over six. ROS looks for two of those by name, at the first use of
a type: empty ones of these names stand in for them. They are loaded with the Python module, so that no search path has
to lead to them, and depend on the one with the contents, where symbols are then found.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_core.private_folders import cache_folder
from diffbot_tools.interfaces.definitions import ACTIONS, PACKAGE

_TYPE_SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
"""What Fast DDS needs: it writes messages with the first, and describes types to others with the second."""
GENERATORS = (
    ("rosidl_generator_c", "generate_c", ()),
    ("rosidl_typesupport_fastrtps_c", "generate_typesupport_fastrtps_c", ()),
    ("rosidl_typesupport_introspection_c", "generate_c", ()),
    ("rosidl_typesupport_c", "generate_c", (list(_TYPE_SUPPORTS),)),
    ("rosidl_generator_py", "generate_py", (["rosidl_typesupport_c"],)),
)
"""Package, function and further arguments; each writes its sources beside the others'."""
_LIBRARIES = (
    "action_msgs", "builtin_interfaces", "geometry_msgs", "service_msgs", "std_msgs", "unique_identifier_msgs",
)  # fmt: skip
_PARTS = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", *_TYPE_SUPPORTS)
_RUNTIME = (
    "fastcdr", "rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c",
)  # fmt: skip
_FLAGS = ("-O1", "-fPIC", "-w")


def default_folder() -> Path:
    """Return the folder of the user's cache for this Python and this environment's ROS.

    Raises:
        DiffbotError: if the cache is not this user's alone: Python would run what is in it.
    """
    return cache_folder() / f"interfaces-jazzy-{sysconfig.get_config_var('SOABI')}"


def build_interfaces(folder: Path, step: Callable[[str], None] = lambda _: None) -> Path:
    """Write the Python package ``nav2_msgs`` with the actions into ``folder``; return the package's folder.

    An older one is replaced when the new one is complete.

    Args:
        folder: parent of the package; made if it does not exist.
        step: called with the name of each step when it begins.

    Raises:
        DiffbotError: in one line, if something is missing or a compiler fails.
    """
    prefix, compilers = ros_prefix(), _compilers()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".build-", dir=folder) as work:
            made = _build(Path(work), prefix, compilers, step)
            target = folder / PACKAGE
            shutil.rmtree(target, ignore_errors=True)
            made.rename(target)
    except OSError as error:
        raise DiffbotError(f"cannot write {folder}: {error.strerror or error}") from None
    return target


def steps() -> int:
    """Return how often :func:`build_interfaces` calls ``step``."""
    return 3 + len(GENERATORS)


def ros_prefix() -> Path:
    """Return the prefix of the ROS packages that interfaces are built against.

    Raises:
        DiffbotError: if there are none with the generators.
    """
    prefixes = [Path(each) for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    for prefix in (*prefixes, Path(sys.prefix)):
        if (prefix / "share" / "rosidl_generator_py").is_dir() and (prefix / "include").is_dir():
            return prefix
    raise DiffbotError("no ROS with rosidl in this environment: install the extra 'jazzy' of diffbot-ros")


def _compilers() -> tuple[str, str]:
    found = shutil.which(os.environ.get("CC", "gcc")), shutil.which(os.environ.get("CXX", "g++"))
    if found[0] is None or found[1] is None:
        raise DiffbotError("no C and C++ compiler: install gcc and g++ (sudo apt-get install g++)")
    return found[0], found[1]


def _build(work: Path, prefix: Path, compilers: tuple[str, str], step: Callable[[str], None]) -> Path:
    step("definitions")
    # The generators report every file on stdout.
    with contextlib.redirect_stdout(io.StringIO()):
        arguments = _describe(work, prefix)
        for name, function, more in GENERATORS:
            step(name)
            resources, output = prefix / "share" / name / "resource", work / name / PACKAGE
            file = _written(
                work / f"{name}.json", arguments | {"template_dir": str(resources), "output_dir": str(output)}
            )
            getattr(importlib.import_module(name), function)(str(file), *more)
            for template in resources.glob("*visibility_control.h.in"):
                _write_visibility(template, output / "msg")
    step("compile")
    objects = _compile(work, prefix, compilers)
    step("link")
    package = work / "rosidl_generator_py" / PACKAGE
    _link(objects, prefix, compilers[1], package)
    (package / "__init__.py").write_text("")
    return _python_part(package, work / "made" / PACKAGE)


def _describe(work: Path, prefix: Path) -> dict[str, Any]:
    """Write definitions and type descriptions; return the arguments of the generators."""
    source, package = work / "source", work / "description" / PACKAGE
    (source / "action").mkdir(parents=True)
    adapter = importlib.import_module("rosidl_adapter.action")
    for name, text in ACTIONS.items():
        (source / "action" / f"{name}.action").write_text(text)
        adapter.convert_action_to_idl(source, PACKAGE, Path("action") / f"{name}.action", source / "action")
    arguments: dict[str, Any] = {
        "package_name": PACKAGE,
        "output_dir": str(package),
        "template_dir": "",
        "idl_tuples": [f"{source}:action/{name}.idl" for name in ACTIONS],
        "ros_interface_dependencies": [],
        "target_dependencies": [],
        "include_paths": [f"{name}:{prefix / 'share' / name}" for name in _LIBRARIES],
    }
    describe = importlib.import_module("rosidl_generator_type_description").generate_type_hash
    describe(str(_written(work / "description.json", arguments)))
    arguments["type_description_tuples"] = [
        f"action/{name}.idl:{package / 'action' / f'{name}.json'}" for name in ACTIONS
    ]
    return arguments


def _written(file: Path, value: Any) -> Path:
    file.write_text(json.dumps(value))
    return file


def _write_visibility(template: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    text = template.read_text().replace("@PROJECT_NAME_UPPER@", PACKAGE.upper()).replace("@PROJECT_NAME@", PACKAGE)
    (folder / template.name.removesuffix(".in")).write_text(text)


def _compile(work: Path, prefix: Path, compilers: tuple[str, str]) -> list[Path]:
    numpy = importlib.import_module("numpy")
    includes = [
        *(work / name for name, *_ in GENERATORS),
        Path(sysconfig.get_path("include")),
        Path(numpy.get_include()),
    ]
    includes += [*sorted(path for path in (prefix / "include").iterdir() if path.is_dir()), prefix / "include"]
    flags = [*_FLAGS, *(f"-I{path}" for path in includes)]
    sources = sorted(work.rglob("*.c")) + sorted(work.rglob("*.cpp"))

    def compiled(source: Path) -> Path:
        target = source.with_name(source.name + ".o")
        command = [compilers[0]] if source.suffix == ".c" else [compilers[1], "-std=c++17"]
        _run([*command, *flags, "-c", str(source), "-o", str(target)])
        return target

    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        return list(pool.map(compiled, sources))


def _link(objects: list[Path], prefix: Path, compiler: str, package: Path) -> None:
    """Link the contents, one stand-in for each type support, and the Python module that loads them all."""
    entry = [path for path in objects if ".ep." in path.name]
    libraries = [f"{name}__{part}" for name in _LIBRARIES for part in _PARTS]
    present = [f"-l{name}" for name in (*libraries, *_RUNTIME) if (prefix / "lib" / f"lib{name}.so").exists()]
    ros = [f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}", *present]

    def shared(name: str, parts: list[Path], needed: list[str], more: list[str]) -> str:
        own = [str(package / each) for each in needed]
        origin = ["-Wl,-rpath,$ORIGIN", "-Wl,--no-as-needed", *own, "-Wl,--as-needed"]
        files = [str(part) for part in parts]
        _run([compiler, "-shared", f"-Wl,-soname,{name}", *files, *origin, *more, "-o", str(package / name)])
        return name

    contents = shared(f"lib{PACKAGE}__contents.so", [path for path in objects if path not in entry], [], ros)
    stand_ins = [shared(f"lib{PACKAGE}__{name}.so", [], [contents], []) for name in _TYPE_SUPPORTS]
    module = f"{PACKAGE}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    shared(module, entry, [contents, *stand_ins], ros)


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        errors = [line for line in done.stderr.splitlines() if "error" in line] or [f"status {done.returncode}"]
        raise DiffbotError(f"{Path(command[0]).name} failed: {' '.join(errors[0].split())[:300]}")


def _python_part(package: Path, target: Path) -> Path:
    """Copy what Python needs: its modules and the library."""
    patterns = ("*.py", "*.so")
    for path in (file for pattern in patterns for file in package.rglob(pattern)):
        goal = target / path.relative_to(package)
        goal.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, goal)
    return target
