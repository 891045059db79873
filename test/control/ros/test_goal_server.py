"""The reason of a cancellation names only senders that may be right."""

from types import SimpleNamespace

import pytest

from diffbot_control.ros.goals.server import GoalServer


@pytest.mark.parametrize(
    ("number", "names"), [(2, "/navigator or /peer"), (3, "/navigator or /peer or an unknown node"), (0, "")]
)
def test_a_client_whose_node_is_not_known_yet_is_named_as_unknown(number, names):
    known = ["peer", "navigator"] if number else []
    node = SimpleNamespace(
        resolve_service_name=lambda name: name.replace("~", "/controller"),
        get_node_names_and_namespaces=lambda: [(name, "/") for name in (*known, "plant")],
        get_client_names_and_types_by_node=lambda name, _: [("/controller/cancel", [])] if name != "plant" else [],
        count_clients=lambda _: number,
    )
    text = GoalServer._caller_of(SimpleNamespace(_node=node), "~/cancel")
    assert text == "by a call of /controller/cancel" + (f" from {names}" if names else "")
