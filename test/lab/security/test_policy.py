"""The SROS2 policy: the form that sros2 reads, and that it says what the nodes do, no more and no less."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import graph
import pytest

from diffbot_lab.security.policy import COMMENT, Rights, name_in_policy, to_xml

POLICY = Path(__file__).resolve().parents[3] / "config" / "sros2_policy.xml"


def test_only_the_controller_may_drive_and_only_the_ekf_may_say_where_the_robot_is():
    enclaves = {one.get("path").removeprefix("/diffbot/"): one for one in ET.parse(POLICY).iter("enclave")}
    for topic, processes in (("cmd_vel", {"controller", "robot"}), ("pose", {"ekf", "robot"})):
        assert {name for name, one in enclaves.items() if one.findall(f".//*[@publish][topic='{topic}']")} == processes
    alone = [ET.tostring(one).strip() for name in ("controller", "ekf") for one in enclaves[name].iter("profile")]
    assert [ET.tostring(one).strip() for one in enclaves["robot"].iter("profile")] == alone


def test_a_policy_has_the_form_that_sros2_reads():
    """By hand, after policy.xsd 0.2.0 of sros2."""
    rights = Rights(publish=frozenset({"a", "~/b"}), call=frozenset({"/c"}))
    text = to_xml({"one": {"node": rights}}, "a comment")
    assert [(one.tag, one.attrib, (one.text or "").strip()) for one in ET.fromstring(text).iter()] == [
        ("policy", {"version": "0.2.0"}, ""),
        ("enclaves", {}, ""),
        ("enclave", {"path": "/diffbot/one"}, ""),
        ("profiles", {}, ""),
        ("profile", {"ns": "/", "node": "node"}, ""),
        ("topics", {"publish": "ALLOW"}, ""),
        ("topic", {}, "a"),
        ("topic", {}, "~/b"),
        ("actions", {"call": "ALLOW"}, ""),
        ("action", {}, "/c"),
    ]


def test_names_are_relative_to_the_node_or_its_namespace():
    short = {
        "/r/ekf/status": "~/status",
        "/r/ekfs/status": "ekfs/status",
        "/r/odom": "odom",
        "/tf": "/tf",
        "/rover/odom": "/rover/odom",
    }
    assert {name: name_in_policy(name, "ekf", "/r") for name in short} == short


def test_an_action_is_one_right_and_not_its_topics_and_services():
    from diffbot_lab.security.ros.graph_rights import rights_of

    topics, services = ("feedback", "status"), ("send_goal", "cancel_goal", "get_result")

    def names(action, parts):
        return [(f"/r/{action}/_action/{part}", []) for part in parts]

    observer = SimpleNamespace(
        get_publisher_names_and_types_by_node=lambda *_: [*names("drive", topics), ("/r/pose", [])],
        get_subscriber_names_and_types_by_node=lambda *_: names("dock", topics),
        get_service_names_and_types_by_node=lambda *_: names("drive", services),
        get_client_names_and_types_by_node=lambda *_: names("dock", services),
    )
    found = rights_of(observer, "node", "/r")
    assert found == Rights(publish=frozenset({"pose"}), execute=frozenset({"drive"}), call=frozenset({"dock"}))


@pytest.mark.graph
def test_the_policy_is_what_the_running_nodes_do():
    from diffbot_lab.security.ros.reference_graph import present_rights, running_graph
    from diffbot_tools.demo.processes import PrivateDomain

    def is_the_policy():
        return to_xml(present_rights(observer), COMMENT) == POLICY.read_text()

    domain = PrivateDomain()
    try:
        with running_graph(domain.id) as observer:
            graph.wait_for(lambda: present_rights(observer), what="all nodes")
            assert graph.comes_true(is_the_policy, graph.PATIENCE), to_xml(present_rights(observer), COMMENT)
    finally:
        domain.release()


@pytest.mark.graph
def test_a_node_that_cannot_be_protected_does_not_start_and_says_so_in_one_line(tmp_path):
    """Keys that are empty files; the wheels' middleware is built without DDS Security and refuses any."""
    (tmp_path / "enclaves").mkdir()
    for name in ("identity_ca.cert", "permissions_ca.cert", "cert", "key"):
        (tmp_path / "enclaves" / f"{name}.pem").touch()
    for name in ("governance", "permissions"):
        (tmp_path / "enclaves" / f"{name}.p7s").touch()
    keys = {"ROS_SECURITY_KEYSTORE": str(tmp_path), "ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    command = [sys.executable, "-m", "diffbot_sim.plant_node"]
    found = subprocess.run(
        command,
        env={**graph.environment(), **keys},
        capture_output=True,
        text=True,
        timeout=graph.PATIENCE,
        check=False,
    )
    assert found.returncode == 1
    (line,) = [line for line in found.stderr.splitlines() if line.startswith("error: ")]
    assert "cannot create the node plant: " in line
    assert "Traceback" not in found.stderr + found.stdout
