"""The package's metadata agree in all places, and with what is installed."""

import ast
import importlib.metadata
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from source_files import PACKAGES, PYTHONS, ROOT, source_tree

EXECUTABLES = {
    "controller_node",
    "diffbot",
    "ekf_node",
    "plant_node",
    "recorder_node",
    "replay_node",
    "robot_node",
}
PACKAGE_OF_IMPORT = {"mcap_ros2": "mcap-ros2-support", "yaml": "PyYAML"}
INSTALLED = importlib.metadata.distribution("diffbot")
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
KEY_OF_ROSDEP = {"python3-yaml": "pyyaml"}
NOBLE = {"matplotlib": "3.6.3", "numpy": "1.26.4", "pyyaml": "6.0.1", "scipy": "1.11.4", "tqdm": "4.66.2"}
"""Ubuntu 24.04's versions of what rosdep installs."""
SOURCES = [path for package in PACKAGES for path in sorted(ROOT.glob(f"{package}/**/*.py"))]
MANIFEST = ET.parse(ROOT / "package.xml").getroot()


def pins(name, python):
    """Return the versions that constraints.txt pins for this package on this Python."""
    environment = {
        **default_environment(),
        "python_version": python,
        "python_full_version": f"{python}.0",
    }
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    requirements = [Requirement(line) for line in lines if line and not line.startswith("#")]
    return [
        next(iter(requirement.specifier)).version
        for requirement in requirements
        if canonicalize_name(requirement.name) == canonicalize_name(name)
        and (requirement.marker is None or requirement.marker.evaluate(environment))
    ]


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
    assert {changelog[1], setup[1], MANIFEST.findtext("version")} == {INSTALLED.version}


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


def test_manifest_has_what_ros_needs():
    assert MANIFEST.tag == "package"
    assert MANIFEST.get("format") == "3"
    assert MANIFEST.findtext("name") == INSTALLED.name
    assert re.fullmatch(r"\d+\.\d+\.\d+", MANIFEST.findtext("version"))
    assert MANIFEST.findtext("description").strip()
    assert MANIFEST.findtext("license") == INSTALLED.metadata["License"]
    assert MANIFEST.find("maintainer").get("email") == INSTALLED.metadata["Maintainer-email"]
    assert MANIFEST.findtext("export/build_type") == "ament_python"
    dependencies = [element.text for element in MANIFEST if element.tag.endswith("_depend")]
    assert len(dependencies) == len(set(dependencies))


def test_every_import_is_a_declared_dependency():
    """Of the package itself or of an extra that users install; what only tests need does not count."""
    at_run_time = {name for extra, names in REQUIREMENTS.items() if extra not in ("test", "lint") for name in names}
    ros = {element.text for element in MANIFEST.iter("exec_depend")}
    imported = {canonicalize_name(PACKAGE_OF_IMPORT.get(name, name)) for name in imported_packages() - ros}
    assert {"numpy", "scipy", "pyyaml", "numba", "distributed"} <= imported
    assert imported - at_run_time == set()


def test_every_dependency_at_run_time_is_imported():
    imported = {canonicalize_name(PACKAGE_OF_IMPORT.get(name, name)) for name in imported_packages()}
    assert set(REQUIREMENTS[""]) - imported == set()


def test_manifest_and_setup_name_the_same_python_packages():
    """rosdep's keys in package.xml and pip's names in the how-to are those of install_requires together."""
    keys = {element.text for element in MANIFEST.iter("exec_depend") if element.text.startswith("python3-")}
    from_rosdep = {canonicalize_name(KEY_OF_ROSDEP.get(key, key.removeprefix("python3-"))) for key in keys}
    page = (ROOT / "docs/how-to/install-on-ros.md").read_text()
    (line,) = re.findall(r"^    pip install --break-system-packages (.*?) +# to run$", page, re.MULTILINE)
    from_pip = {canonicalize_name(Requirement(word.strip('"')).name) for word in line.split()}
    assert from_rosdep & from_pip == set()
    assert from_rosdep | from_pip == set(REQUIREMENTS[""])
    assert {key for key in keys if f"`{key}`" not in page} == set()


def test_no_lower_bound_is_above_what_rosdep_installs():
    keys = {element.text for element in MANIFEST.iter("exec_depend") if element.text.startswith("python3-")}
    assert {canonicalize_name(KEY_OF_ROSDEP.get(key, key.removeprefix("python3-"))) for key in keys} == set(NOBLE)
    bounds = {canonicalize_name(one.name): one.specifier for one in DIRECT if one.marker is None}
    assert [name for name, version in NOBLE.items() if not bounds[name].contains(version)] == []


def test_rosdep_is_not_asked_for_what_only_pip_has():
    """On an externally managed Python rosdep fails with such a key, and with it the whole installation."""
    assert [element.text for element in MANIFEST.iter() if (element.text or "").endswith("-pip")] == []


def test_lower_bounds_are_the_same_wherever_they_are_named():
    bounds = {canonicalize_name(requirement.name): str(requirement.specifier) for requirement in DIRECT}
    named = re.compile(r"\b(" + "|".join(re.escape(requirement.name) for requirement in DIRECT) + r")(>=[\d.]*\d)")
    found = {
        (str(path.relative_to(ROOT)), *match.groups())
        for path in source_tree()
        if path.suffix in (".py", ".md", ".xml", ".toml", ".cfg") and path.name != "CHANGELOG.md"
        for match in named.finditer(path.read_text(encoding="utf-8"))
    }
    assert {("setup.py", "numba", bounds["numba"]), ("diffbot_sim/compiled/jit.py", "numba", bounds["numba"])} <= found
    assert {one for one in found if bounds[canonicalize_name(one[1])] != one[2]} == set()


@pytest.mark.parametrize("python", PYTHONS)
def test_constraints_pin_every_direct_dependency_within_its_bound(python):
    found = {requirement.name: pins(requirement.name, python) for requirement in DIRECT}
    assert {name: versions for name, versions in found.items() if len(versions) != 1} == {}
    outside = [str(bound) for bound in DIRECT if not bound.specifier.contains(found[bound.name][0])]
    assert outside == []


def test_constraints_pin_what_is_installed():
    """Everything but the extra bound, which `make setup` does not install."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    names = set().union(*(names for extra, names in REQUIREMENTS.items() if extra != "bound"))
    waiting = [one for one in DIRECT if canonicalize_name(one.name) in names]
    visited, wrong = set(), []
    while waiting:
        requirement = waiting.pop()
        key = (canonicalize_name(requirement.name), frozenset(requirement.extras))
        if key in visited:
            continue
        visited.add(key)
        distribution = importlib.metadata.distribution(requirement.name)
        if pins(requirement.name, python) != [distribution.version]:
            wrong.append(f"{requirement.name} {distribution.version}")
        for line in distribution.requires or []:
            child = Requirement(line)
            marker = child.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in {"", *requirement.extras}):
                waiting.append(child)
    assert wrong == []


@pytest.mark.parametrize("extra", REQUIREMENTS)
def test_docs_list_the_dependencies_of_each_extra_with_their_pins(extra):
    page = (ROOT / "docs/reference/dependencies.md").read_text()
    heading = f"## Extra `{extra}`" if extra else "## Needed to run"
    (section,) = re.findall(rf"^{re.escape(heading)}.*?(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| ")][1:]
    cells = {canonicalize_name(row[0].strip()): [cell.strip() for cell in row] for row in rows}
    assert set(cells) == REQUIREMENTS[extra]
    for name, row in cells.items():
        assert all(row), row
        assert set(row[-1].split(" / ")) == {pins(name, python)[0] for python in PYTHONS}, name


def test_no_machine_paths_and_no_registry_hosts():
    hosts = [
        ("pypi", "org"),
        ("pythonhosted", "org"),
        ("debian", "org"),
        ("ubuntu", "com"),
        ("npmjs", "org"),
    ]
    unwanted = re.compile(
        "|".join(rf"\b{name}\.{domain}\b" for name, domain in hosts) + r"|(?<![\w.~}-])/(?:home|root|Users|work)/\w"
    )
    found = [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in source_tree()
        for match in unwanted.finditer(path.read_bytes().decode("utf-8", "ignore"))
    ]
    assert found == []
