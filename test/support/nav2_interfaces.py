"""Builds nav2_msgs with the actions that the controllers serve: no wheel contains this package.

The wheels contain headers, libraries and the generators of rosidl; the build also needs a C and a C++ compiler. One
shared library contains the code that an installation divides into six. ROS looks for two of the six by name at the
first use of a type: empty libraries with these names replace them. The Python module loads the empty libraries, so that
a search path is not necessary, and they depend on the library with the contents, where ROS then finds the symbols.

Two nodes understand each other only if every field agrees with Jazzy's definition.
"""

import contextlib
import hashlib
import importlib.metadata
import io
import json
import os
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

PACKAGE = "nav2_msgs"
_RESULT = """\
uint16 NONE=0
uint16 error_code
string error_msg
"""
_FEEDBACK = """\
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
"""
_PATH_ERRORS = """\
uint16 NONE=0
uint16 UNKNOWN=100
uint16 INVALID_CONTROLLER=101
uint16 TF_ERROR=102
uint16 INVALID_PATH=103
uint16 PATIENCE_EXCEEDED=104
uint16 FAILED_TO_MAKE_PROGRESS=105
uint16 NO_VALID_CONTROL=106
uint16 CONTROLLER_TIMED_OUT=107
"""
_DOCK_ERRORS = """\
uint16 NONE=0
uint16 DOCK_NOT_IN_DB=901
uint16 DOCK_NOT_VALID=902
uint16 FAILED_TO_STAGE=903
uint16 FAILED_TO_DETECT_DOCK=904
uint16 FAILED_TO_CONTROL=905
uint16 FAILED_TO_CHARGE=906
uint16 UNKNOWN=999
"""
_UNDOCK_ERRORS = """\
uint16 NONE=0
uint16 DOCK_NOT_VALID=902
uint16 FAILED_TO_CONTROL=905
uint16 UNKNOWN=999
"""
_DOCK_GOAL = """\
bool use_dock_id true
string dock_id
geometry_msgs/PoseStamped dock_pose
string dock_type
float32 max_staging_time 1000.0
bool navigate_to_staging_pose true
"""
# The parser drops the second of two equal constants of an action. A comment makes them different.
_DOCK_FEEDBACK = """\
uint16 NONE=0  # no state
uint16 NAV_TO_STAGING_POSE=1
uint16 INITIAL_PERCEPTION=2
uint16 CONTROLLING=3
uint16 WAIT_FOR_CHARGE=4
uint16 RETRY=5
uint16 state
builtin_interfaces/Duration docking_time
uint16 num_retries 0
"""
_DOCK_RESULT = "bool success true\nuint16 error_code 0\n"
ACTIONS = {
    "NavigateToPose": f"geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\n{_RESULT}---\n{_FEEDBACK}",
    "NavigateThroughPoses": (
        "geometry_msgs/PoseStamped[] poses\nstring behavior_tree\n"
        f"---\n{_RESULT}---\n{_FEEDBACK}int16 number_of_poses_remaining\n"
    ),
    "FollowPath": (
        "nav_msgs/Path path\nstring controller_id\nstring goal_checker_id\nstring progress_checker_id\n"
        f"---\n{_PATH_ERRORS}std_msgs/Empty result\nuint16 error_code\nstring error_msg\n"
        "---\nfloat32 distance_to_goal\nfloat32 speed\n"
    ),
    "DockRobot": (
        f"{_DOCK_GOAL}---\n{_DOCK_ERRORS}{_DOCK_RESULT}uint16 num_retries 0\nstring error_msg\n---\n{_DOCK_FEEDBACK}"
    ),
    "UndockRobot": (
        f"string dock_type\nfloat32 max_undocking_time 30.0\n---\n{_UNDOCK_ERRORS}{_DOCK_RESULT}string error_msg\n---\n"
    ),
}

TYPE_SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
"""Type supports of Fast DDS: it writes messages with the first, and describes types to others with the second."""
GENERATORS = (
    ("rosidl_generator_c", "generate_c", ()),
    ("rosidl_typesupport_fastrtps_c", "generate_typesupport_fastrtps_c", ()),
    ("rosidl_typesupport_introspection_c", "generate_c", ()),
    ("rosidl_typesupport_c", "generate_c", (list(TYPE_SUPPORTS),)),
    ("rosidl_generator_py", "generate_py", (["rosidl_typesupport_c"],)),
)
"""Package, function and further arguments of each generator."""
LIBRARIES = (
    "action_msgs", "builtin_interfaces", "geometry_msgs", "nav_msgs", "service_msgs", "std_msgs",
    "unique_identifier_msgs",
)  # fmt: skip
PARTS = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", *TYPE_SUPPORTS)
RUNTIME = (
    "fastcdr", "rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c",
)  # fmt: skip


def key():
    """Return a name for the result of :func:`build` with this file, this Python and these ROS wheels."""
    wheels = sorted(f"{one.name} {one.version}" for one in importlib.metadata.distributions() if "ros-" in one.name)
    made_from = (Path(__file__).read_text(), sysconfig.get_config_var("SOABI"), str(_prefix()), *wheels)
    return hashlib.sha256("\n".join(made_from).encode()).hexdigest()[:16]


def build(folder):
    """Write the package into ``folder``; needs gcc, g++ and the ROS wheels."""
    prefix = _prefix()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".build-", dir=folder) as work:
        # The generators print every file.
        with contextlib.redirect_stdout(io.StringIO()):
            _generate(Path(work), prefix)
        package = Path(work) / "rosidl_generator_py" / PACKAGE
        _link(_compile(Path(work), prefix), prefix, package)
        (package / "__init__.py").write_text("")
        for leftover in [*package.rglob("*.c"), *package.rglob("*.o")]:
            leftover.unlink()
        package.rename(folder / PACKAGE)


def _prefix():
    """Return the prefix of the ROS packages with the generators."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    return next(path for path in map(Path, prefixes) if (path / "share" / "rosidl_generator_py").is_dir())


def _generate(work, prefix):
    """Write definitions, type descriptions and sources."""
    source, description = work / "source", work / "description" / PACKAGE
    (source / "action").mkdir(parents=True)
    adapter = importlib.import_module("rosidl_adapter.action")
    for name, text in ACTIONS.items():
        (source / "action" / f"{name}.action").write_text(text)
        adapter.convert_action_to_idl(source, PACKAGE, Path("action") / f"{name}.action", source / "action")
    arguments = {
        "package_name": PACKAGE,
        "output_dir": str(description),
        "template_dir": "",
        "idl_tuples": [f"{source}:action/{name}.idl" for name in ACTIONS],
        "ros_interface_dependencies": [],
        "target_dependencies": [],
        "include_paths": [f"{name}:{prefix / 'share' / name}" for name in LIBRARIES],
    }
    (work / "arguments.json").write_text(json.dumps(arguments))
    describe = importlib.import_module("rosidl_generator_type_description").generate_type_hash
    describe(str(work / "arguments.json"))
    arguments["type_description_tuples"] = [
        f"action/{name}.idl:{description / 'action' / f'{name}.json'}" for name in ACTIONS
    ]
    for name, function, more in GENERATORS:
        resources, output = prefix / "share" / name / "resource", work / name / PACKAGE
        arguments |= {"template_dir": str(resources), "output_dir": str(output)}
        (work / "arguments.json").write_text(json.dumps(arguments))
        getattr(importlib.import_module(name), function)(str(work / "arguments.json"), *more)
        for template in resources.glob("*visibility_control.h.in"):
            text = template.read_text().replace("@PROJECT_NAME_UPPER@", PACKAGE.upper())
            (output / "msg").mkdir(parents=True, exist_ok=True)
            (output / "msg" / template.name.removesuffix(".in")).write_text(text.replace("@PROJECT_NAME@", PACKAGE))


def _compile(work, prefix):
    """Compile all sources; return the object files."""
    headers = prefix / "include"
    includes = [
        *(work / name for name, *_ in GENERATORS),
        sysconfig.get_path("include"),
        np.get_include(),
        *(path for path in headers.iterdir() if path.is_dir()),
        headers,
    ]
    flags = ["-O0", "-fPIC", "-w", *(f"-I{path}" for path in includes)]

    def compiled(source):
        target = source.with_name(source.name + ".o")
        compiler = ["gcc"] if source.suffix == ".c" else ["g++", "-std=c++17"]
        subprocess.run([*compiler, *flags, "-c", source, "-o", target], check=True)
        return target

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(compiled, [*work.rglob("*.c"), *work.rglob("*.cpp")]))


def _link(objects, prefix, package):
    """Link the contents, an empty library for each type support, and the Python module that loads them all."""
    entry = [path for path in objects if ".ep." in path.name]
    libraries = [f"{name}__{part}" for name in LIBRARIES for part in PARTS]
    present = [f"-l{name}" for name in (*libraries, *RUNTIME) if (prefix / "lib" / f"lib{name}.so").exists()]
    ros = [f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}", *present]

    def shared(name, parts, needed, more):
        own = [package / each for each in needed]
        origin = ["-Wl,-rpath,$ORIGIN", "-Wl,--no-as-needed", *own, "-Wl,--as-needed"]
        command = ["g++", "-shared", f"-Wl,-soname,{name}", *parts, *origin, *more, "-o", package / name]
        subprocess.run(command, check=True)
        return name

    contents = shared(f"lib{PACKAGE}__contents.so", [path for path in objects if path not in entry], [], ros)
    stand_ins = [shared(f"lib{PACKAGE}__{name}.so", [], [contents], []) for name in TYPE_SUPPORTS]
    module = f"{PACKAGE}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    shared(module, entry, [contents, *stand_ins], ros)
