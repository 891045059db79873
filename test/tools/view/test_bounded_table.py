"""Tables of names that others choose stay small, and keep what was set last."""

from diffbot_tools.view.events import MAX_NAMES, EventMaker
from diffbot_tools.view.texts import Status


def test_a_node_that_reports_on_keeps_its_fault_among_any_number_of_names():
    maker, fault = EventMaker(), Status(2, "/ekf", "broken", {})
    assert len(maker.of_diagnostics(0.0, [fault])) == 1
    for number in range(3 * MAX_NAMES):
        others = [Status(0, f"/other{number}", "ok", {})]
        results = [Status(0, f"goal {number}", "reached", {})]
        counters = Status(0, "/ekf", "ok", {f"fix{number} rejected": "1"})
        maker.of_results(1.0, results)
        maker.of_status(1.0, "filter", counters)
        assert maker.of_diagnostics(1.0, [*others, fault]) == []
    assert all(len(one) <= MAX_NAMES for one in vars(maker).values() if hasattr(one, "__len__"))
