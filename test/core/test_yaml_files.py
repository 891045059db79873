"""YAML contains plain values only; a section of a parameter file applies to the same nodes as in rcl."""

import pytest
import rclpy
from rclpy.node import Node

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.yaml_files import ParameterFiles, dump_yaml, load_yaml, read_sections, values_for

SECTIONS = """\
/**: {ros__parameters: {p0: 1}}
/**/controller: {ros__parameters: {p1: 1}}
/*/controller: {ros__parameters: {p2: 1}}
controller: {ros__parameters: {p3: 1}}
/r1/controller: {ros__parameters: {p4: {inner: 1}}}
r1:
  controller: {ros__parameters: {p5: 1}}
  arm: {controller: {ros__parameters: {p6: 1}}}
/r1/**: {ros__parameters: {p7: 1}}
/*: {ros__parameters: {p8: 1}}
"""


@pytest.fixture
def file(tmp_path):
    def make(text, name="my.yaml"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return make


def given(*files):
    return ParameterFiles(word for one in files for word in ("--params-file", str(one)))


@pytest.mark.parametrize("namespace", ["", "/r1", "/r1/arm", "/r2"])
@pytest.mark.parametrize("name", ["controller", "ekf"])
def test_a_section_is_for_the_nodes_to_which_rcl_applies_it(file, namespace, name):
    path = file(SECTIONS)
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
    try:
        node = Node(name, namespace=namespace, context=context, automatically_declare_parameters_from_overrides=True)
        by_rcl = {one for one in node.get_parameters_by_prefix("") if one.startswith("p")}
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    ours = {key for one in read_sections(path) if one.is_for(f"{namespace}/{name}") for key in one.values}
    assert ours == by_rcl


@pytest.mark.parametrize("section", ["/**/controler", "/**/contorller", "controllers", "r1: {Controller"])
def test_a_misspelt_section_is_refused_when_the_node_starts(file, section):
    path = file(f"{section}: {{ros__parameters: {{gamma: 0.2}}}}" + "}" * section.count("{"))
    with pytest.raises(DiffbotError, match=rf"{path}: section .*ont.*: did you mean controller\?$"):
        given(path).add_node("/r1/controller")


OTHERS = ["/**/controller_server", "/controller_1", "/dock_controller", "/**/plant", "/**/ekf_filter_node", "/**"]


@pytest.mark.parametrize("section", OTHERS)
def test_sections_of_other_nodes_are_not_refused(file, section):
    given(file(f"{section}: {{ros__parameters: {{a: 1}}}}")).add_node("/controller")
    given(file("/**/ekf: {ros__parameters: {a: 1}}\n/**/ekf2: {ros__parameters: {a: 1}}")).add_node("/ekf")
    given(file("/**/controller: {ros__parameters: {a: 1}}")).add_node("/dock_controller")


def test_a_file_without_a_section_for_a_node_of_the_process_is_refused(file):
    one, two = file("/**/ekf: {ros__parameters: {a: 1}}", "one"), file("/r2/**: {ros__parameters: {a: 1}}", "two")
    files = given(one, two)
    files.add_node("/r1/ekf")
    files.add_node("/r1/controller")
    with pytest.raises(DiffbotError, match=rf"^{two} has no section for /r1/ekf or /r1/controller, only for /r2/\*\*$"):
        files.check_all_used()
    files.add_node("/r2/plant")
    files.check_all_used()


def test_an_error_names_the_node_and_the_file_and_section_that_set_the_value(file):
    first = file("/**/ekf: {ros__parameters: {gate: -1.0}}", "first")
    last = file("/**: {ros__parameters: {gate: -2.0}}\n/**/plant: {ros__parameters: {gate: -3.0}}", "last")
    error = InvalidValueError("gate", -2.0, ">= 0")
    files = given(first, last)
    assert files.error_text(error) == "gate = -2.0: must be >= 0"
    files.add_node("/ekf")
    assert files.error_text(error) == f"/ekf: gate = -2.0: must be >= 0 ({last}, section /**)"
    typed = ParameterFiles(["--params-file", str(first), "-p", "ekf:gate:=-2.0"])
    typed.add_node("/ekf")
    assert typed.error_text(error) == "/ekf: gate = -2.0: must be >= 0"


def test_the_values_of_a_node_come_from_sections_of_any_namespace(file):
    path = file("/r1/ekf: {ros__parameters: {a: 1, b: {c: 2}}}\n/**: {ros__parameters: {a: 3}}\nx: 5")
    assert values_for(path, "ekf") == {"a": 3, "b.c": 2}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 3000, "is not a YAML file"),
        ("a: [1", "is not a YAML file"),
        ("date: 2001-99-99", "is not a YAML file"),
        ("!!python/object/apply:os.getcwd []", "is not a YAML file"),
        ("{a: 1, b: {c: 1, c: 2}}", "the key 'c' occurs twice"),
    ],
)
def test_yaml_that_is_invalid_or_has_other_types_is_refused_in_one_line(text, words):
    with pytest.raises(DiffbotError, match=f"^my file .*{words}") as caught:
        load_yaml(text, "my file", unique_keys=True)
    assert "\n" not in str(caught.value)


def test_dumped_values_are_loaded_unchanged_and_in_their_order():
    content = {"z": [1, 2.5, True, None], "a": {"text": "on", "large": 10**30}}
    assert list(load_yaml(dump_yaml(content), "it").items()) == list(content.items())
