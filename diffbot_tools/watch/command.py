"""The command ``diffbot watch``."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from typing import Any

from diffbot_tools.arguments import ros_parameters, whole
from diffbot_tools.watch.parameters import WatchConfig


def add_watch(commands: Any) -> None:
    """Add ``diffbot watch`` to the subparsers of the command line."""
    defaults = WatchConfig()
    watch = commands.add_parser("watch", help="show a running robot in the browser, and send it goals from there")
    watch.add_argument("--host", default=defaults.host, help="address to listen on (default: %(default)s)")
    watch.add_argument(
        "--port",
        type=whole(0, 65535),
        default=defaults.port,
        help="port to listen on; 0 chooses a free port (default: %(default)s)",
    )
    watch.add_argument(
        "--namespace", nargs="+", default=[""], metavar="NS", help="namespaces of the robots (default: none)"
    )
    watch.add_argument("--record", type=Path, metavar="FOLDER", help="allow the page to record bags into this folder")
    watch.add_argument("--open", action="store_true", help="open the page in the browser")
    watch.add_argument(
        "--ros-args",
        dest="ros_args",
        nargs=argparse.REMAINDER,
        default=[],
        help="arguments for ROS, such as remappings",
    )
    watch.set_defaults(call=_call)


def _call(options: argparse.Namespace) -> int:
    values = {
        "host": options.host,
        "port": options.port,
        "namespaces": options.namespace,
        "record_folder": str(options.record.absolute()) if options.record else "",
        "open_browser": options.open,
    }
    # Imported by name, since the command line must work without ROS.
    node = importlib.import_module("diffbot_tools.watch.watch_node")
    return int(node.main(["--ros-args", *ros_parameters(values), *options.ros_args]))
