"""The metadata of the package agree with each other and with the installed package."""

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
"""Direct dependencies by extra; "" for the dependencies of every installation."""
KEY_OF_ROSDEP = {"python3-yaml": "pyyaml"}
SOURCES = [path for package in PACKAGES for path in sorted(ROOT.glob(f"{package}/**/*.py"))]
MANIFEST = ET.parse(ROOT / "package.xml").getroot()


def imported_packages():
    """Return the top-level names of all imports of the package and its launch files."""
    names = set()
    for path in [*SOURCES, *ROOT.glob("launch/*.py")]:
        for node in ast.walk(ast.parse(path.read_text(), str(path))):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(node.module.split(".")[0])
    return names - set(sys.stdlib_module_names) - set(PACKAGES)


def test_the_version_is_the_same_in_all_files():
    changelog = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    setup = re.search(r'^    version="(.+)",$', (ROOT / "setup.py").read_text(), re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {changelog[1], setup[1], MANIFEST.findtext("version"), citation["version"]} == {INSTALLED.version}


def test_the_installed_package_is_this_source_tree():
    site = Path(INSTALLED.locate_file(""))
    installed = {path for package in PACKAGES for path in site.glob(f"{package}/**/*.py")}
    assert {path.relative_to(site) for path in installed} == {path.relative_to(ROOT) for path in SOURCES}
    stale = [str(path) for path in SOURCES if path.read_bytes() != (site / path.relative_to(ROOT)).read_bytes()]
    assert not stale, "run `make setup`"


def test_every_executable_is_a_function():
    scripts = INSTALLED.entry_points.select(group="console_scripts")
    assert len(scripts) == 8
    assert [script.name for script in scripts if not callable(script.load())] == []


def test_every_import_is_a_declared_dependency():
    at_run_time = {name for extra, names in REQUIREMENTS.items() if extra not in ("test", "lint") for name in names}
    ros = {element.text for element in MANIFEST.iter("exec_depend")}
    imported = {canonicalize_name(PACKAGE_OF_IMPORT.get(name, name)) for name in imported_packages() - ros}
    assert {"numpy", "scipy", "pyyaml", "numba", "distributed"} <= imported
    assert imported - at_run_time == set()
    assert set(REQUIREMENTS[""]) - imported == set()


def test_package_xml_the_how_to_and_the_dockerfile_install_the_dependencies_of_setup_py():
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


def test_no_text_installs_the_package_that_is_called_diffbot_on_pypi():
    """It belongs to another project."""
    command = re.compile(rb"\bpip3? install (?:[^\n`]* )?['\"]?diffbot(?![\w-])|(?<![\w-])diffbot\[[a-z]+[],]")
    found = [str(path) for path in source_tree() if path.name != "CHANGELOG.md" and command.search(path.read_bytes())]
    assert found == []


def test_no_file_contains_paths_of_a_machine_or_hosts_of_registries():
    hosts = rb"\b(?:pypi|pythonhosted|debian)\.org\b|\bubuntu\.com\b|\bnpmjs\.org\b"
    unwanted = re.compile(hosts + rb"|(?<![\w.~}-])/(?:home|root|Users|work)/\w")
    found = {
        str(path.relative_to(ROOT)): match[0] for path in source_tree() if (match := unwanted.search(path.read_bytes()))
    }
    assert found == {}
