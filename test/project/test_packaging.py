"""The package's metadata agree in all places, and with what is installed."""

import ast
import importlib.metadata
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from source_files import PACKAGES, ROOT, source_tree

from diffbot_core.installed import DISTRIBUTION

EXECUTABLES = {
    *("controller_node", "diffbot", "docking_node", "ekf_node", "plant_node", "recorder_node", "replay_node"),
    "robot_node",
}
PACKAGE_OF_IMPORT = {"mcap_ros2": "mcap-ros2-support", "ruamel": "ruamel.yaml", "yaml": "PyYAML"}
INSTALLED = importlib.metadata.distribution(DISTRIBUTION)
DIRECT = [Requirement(line) for line in INSTALLED.requires]
REQUIREMENTS = {
    extra: {
        canonicalize_name(requirement.name)
        for requirement in DIRECT
        if (requirement.marker is None) == (extra == "")
        and (requirement.marker is None or requirement.marker.evaluate({"extra": extra}))
    }
    for extra in ("", *INSTALLED.metadata.get_all("Provides-Extra"))
}
"""Direct dependencies by extra; "" are those that every installation has."""
TEXTS = {"", ".cff", ".cfg", ".ipynb", ".md", ".py", ".toml", ".txt", ".xml", ".yaml", ".yml"}
KEY_OF_ROSDEP = {"python3-yaml": "pyyaml"}
SOURCES = [path for package in PACKAGES for path in sorted(ROOT.glob(f"{package}/**/*.py"))]
MANIFEST = ET.parse(ROOT / "package.xml").getroot()


def imported_packages():
    """Return the outermost names of all absolute imports of the package and its launch files."""
    names = set()
    for path in [*SOURCES, *ROOT.glob("launch/*.py")]:
        for node in ast.walk(ast.parse(path.read_text(), str(path))):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(node.module.split(".")[0])
    return names - set(sys.stdlib_module_names) - set(PACKAGES)


def test_version_is_the_same_everywhere():
    changelog = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    setup = re.search(r'^    version="(.+)",$', (ROOT / "setup.py").read_text(), re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {changelog[1], setup[1], MANIFEST.findtext("version"), citation["version"]} == {INSTALLED.version}


def test_installed_package_is_this_source_tree():
    site = Path(INSTALLED.locate_file(""))
    installed = {path for package in PACKAGES for path in site.glob(f"{package}/**/*.py")}
    assert {path.relative_to(site) for path in installed} == {path.relative_to(ROOT) for path in SOURCES}
    stale = [str(path) for path in SOURCES if path.read_bytes() != (site / path.relative_to(ROOT)).read_bytes()]
    assert not stale, "run `make setup`"


def test_every_executable_resolves_to_a_function():
    scripts = INSTALLED.entry_points.select(group="console_scripts")
    assert {script.name for script in scripts} == EXECUTABLES
    assert [script.name for script in scripts if not callable(script.load())] == []


def test_every_import_is_a_declared_dependency():
    """Of the package itself or of an extra that users install; what only tests need does not count."""
    at_run_time = {name for extra, names in REQUIREMENTS.items() if extra not in ("test", "lint") for name in names}
    ros = {element.text for element in MANIFEST.iter("exec_depend")}
    imported = {canonicalize_name(PACKAGE_OF_IMPORT.get(name, name)) for name in imported_packages() - ros}
    assert {"numpy", "scipy", "pyyaml", "numba", "distributed"} <= imported
    assert imported - at_run_time == set()
    assert set(REQUIREMENTS[""]) - imported == set()


def test_manifest_and_setup_name_the_same_python_packages():
    """rosdep's keys in package.xml and pip's names in the how-to, and in the Dockerfile, are install_requires."""
    keys = {element.text for element in MANIFEST.iter("exec_depend") if element.text.startswith("python3-")}
    from_rosdep = {canonicalize_name(KEY_OF_ROSDEP.get(key, key.removeprefix("python3-"))) for key in keys}
    page = (ROOT / "docs/how-to/install-on-ros.md").read_text()
    (line,) = re.findall(r"^    pip install --break-system-packages (.*?) +# to run$", page, re.MULTILINE)
    from_pip = {canonicalize_name(Requirement(word.strip('"')).name) for word in line.split()}
    assert from_rosdep & from_pip == set()
    assert from_rosdep | from_pip == set(REQUIREMENTS[""])
    (expression,) = re.findall(r"grep -E '(.*?)' ", (ROOT / "Dockerfile").read_text())
    pinned = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if re.search(expression, line)]
    assert {canonicalize_name(Requirement(line).name) for line in pinned} == from_pip


def test_the_name_for_pip_is_the_project_s_own_and_that_for_ros_is_diffbot():
    assert INSTALLED.metadata["Name"] == DISTRIBUTION == "diffbot-ros"
    assert MANIFEST.findtext("name") == "diffbot"
    assert not any(importlib.metadata.distributions(name="diffbot")), "a stranger's, or that of an earlier version"


def packages_to_install(text):
    """Yield the names of all packages that the commands ``pip install`` in a text install."""
    for command in re.findall(r"\bpip3? install\s+(?=(.+))", text):
        for word in command.split():
            name = re.match(r"""['"]?([A-Za-z0-9][A-Za-z0-9._-]*)""", word)
            if name and not name[1].endswith((".txt", ".whl")):
                yield canonicalize_name(name[1])
            # A comment, the next command, or the end of a quotation.
            if word[0] in "#&|;(" or re.search(r"[`;|)]|\\n", word):
                break


def test_no_text_tells_to_install_a_package_of_a_stranger():
    """Neither an error message nor a page; CHANGELOG.md says what was."""
    known = {DISTRIBUTION, *(name for names in REQUIREMENTS.values() for name in names)}
    found = {}
    for path in source_tree():
        if path.suffix in TEXTS and path != ROOT / "CHANGELOG.md":
            text = path.read_text(encoding="utf-8")
            for name in packages_to_install(text):
                found.setdefault(name, set()).add(str(path.relative_to(ROOT)))
            if re.search(r"(?<![\w-])diffbot\[[a-z]+[],]", text):
                found.setdefault("diffbot", set()).add(str(path.relative_to(ROOT)))
    assert {DISTRIBUTION, "filterpy", "numba"} <= set(found)
    assert {name: paths for name, paths in found.items() if name not in known} == {}


def test_no_machine_paths_and_no_registry_hosts():
    hosts = [("pypi", "org"), ("pythonhosted", "org"), ("debian", "org"), ("ubuntu", "com"), ("npmjs", "org")]
    unwanted = re.compile(
        "|".join(rf"\b{name}\.{domain}\b" for name, domain in hosts) + r"|(?<![\w.~}-])/(?:home|root|Users|work)/\w"
    )
    found = [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in source_tree()
        for match in unwanted.finditer(path.read_bytes().decode("utf-8", "ignore"))
    ]
    assert found == []
