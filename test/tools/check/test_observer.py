"""The topics that `diffbot check` observes, without a graph."""

from types import SimpleNamespace

from diffbot_tools.check.ros.observer import Observer

FIX = "geometry_msgs/msg/PoseWithCovarianceStamped"


def test_a_remapped_fix_is_found_beside_a_further_source_of_fixes():
    found = [(topic, [FIX]) for topic in ("/amcl_pose", "/gps", "/initialpose")]
    observer = object.__new__(Observer)
    observer._node = SimpleNamespace(
        resolve_topic_name="/{}".format,
        get_namespace=lambda: "/",
        get_subscriber_names_and_types_by_node=lambda *_: found,
        get_publisher_names_and_types_by_node=lambda *_: [],
    )
    kinds = {"global_pose": (FIX,), "gps": (FIX,)}
    assert [observer._topic(name, kinds, is_input=True) for name in kinds] == ["/amcl_pose", "/gps"]
