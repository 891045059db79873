"""What is promised for each fault: its bound, and how often it is tried by ``make faults`` and by ``make test``."""

from typing import NamedTuple

POSE_TIMEOUT = 0.5
"""[s] the controller's default"""
COMMAND_TIMEOUT = 0.5
"""[s] cmd_vel_timeout, the plant's default"""
PERIOD = 0.1
"""[s] of plant, poses and commands"""
LOST_INPUT = POSE_TIMEOUT + PERIOD
LOST_COMMANDS = COMMAND_TIMEOUT + PERIOD
LOST_MESSAGES = 0.5
"""[s] of a recorder with default parameters"""
RECEIVED_SHARE = 0.9
"""Share of the hostile messages that the nodes have to have handled for the test to count."""
NEVER = 3600.0
"""[s] cmd_vel_timeout where the controller has to stop the robot, not its base"""


class Promise(NamedTuple):
    """A fault, what holds then, and how often it is tried."""

    fault: str
    text: str
    full: int
    """trials of ``make faults``"""
    short: int
    """trials of ``make test``"""
    bound: float | None = None
    """largest value allowed; without one a trial is only kept or broken"""
    unit: str = "s"


_STOP = "zero on cmd_vel within pose_timeout + one period"
_BASE = "the base's own cmd_vel_timeout stops it, + one period"
_BAGS = (
    "a result or one line of refusal within 5 s of processor time and 300 MB; "
    "the input stays as it is; no part of an output"
)
_END = "status 0 within 2 s, no traceback"

PROMISES = {
    "kill ekf": Promise("kill -9 of ekf", f"{_STOP}; with a new ekf the robot drives on", 20, 1, LOST_INPUT),
    "kill plant": Promise("kill -9 of the plant: no odometry, no fixes", f"{_STOP}; drives on", 20, 1, LOST_INPUT),
    "kill controller": Promise(
        "kill -9 of the controller", f"{_BASE}; a new one drives to goals", 20, 1, LOST_COMMANDS
    ),
    "kill robot": Promise("kill -9 of robot_node", f"{_BASE}; a new one drives to goals", 20, 1, LOST_COMMANDS),
    "kill recorder": Promise(
        "kill -9 of the recorder",
        "the robot drives on; all but the last 0.5 s is in the bag",
        20,
        1,
        LOST_MESSAGES,
    ),
    "stop ekf": Promise("SIGSTOP of ekf, then SIGCONT", f"{_STOP}; then it drives on", 20, 1, LOST_INPUT),
    "stop plant": Promise("SIGSTOP of the plant, then SIGCONT", f"{_STOP}; then it drives on", 10, 1, LOST_INPUT),
    "stop controller": Promise(
        "SIGSTOP of the controller, then SIGCONT", f"{_BASE}; then it drives on", 10, 1, LOST_COMMANDS
    ),
    "stop recorder": Promise(
        "SIGSTOP of the recorder for 2 s", "what the publisher's queue could not hold is counted as lost, exactly", 5, 1
    ),
    "clock stands": Promise("/clock stands still, poses go on", f"{_STOP}; then it drives on", 20, 1, LOST_INPUT),
    "clock back": Promise("/clock jumps back by 500 s", f"{_STOP}; then it drives on", 10, 1, LOST_INPUT),
    "clock two": Promise("a second publisher of /clock", f"{_STOP}; named in /diagnostics", 10, 1, LOST_INPUT),
    "clock forward": Promise("/clock jumps ahead by 500 s", "the goal is kept; drives on within 1 s", 10, 1, 1.0),
    "odometry frozen": Promise(
        "odometry repeats its stamp, fixes go on", f"{_STOP}; the goal ends; named in /diagnostics", 20, 1, LOST_INPUT
    ),
    **{
        key: Promise(f"fixes {text}", "stands within 20 s; the goal ends; named in /diagnostics", 20, 1, 20.0)
        for key, text in (
            ("fixes turned", "with the heading turned by 180 deg"),
            ("fixes mirrored", "mirrored"),
            ("fixes swapped", "with x and y swapped"),
            ("fixes frozen", "that repeat one pose"),
        )
    },
    "found elsewhere": Promise("the robot is found 3 m from a held goal", "it stands, and the goal is let go", 20, 1),
    "network": Promise(
        "odometry and fixes: 20 % lost, 200 to 300 ms late, 5 % twice, in another order", "goals are reached", 20, 1
    ),
    "flood": Promise(
        "goals at 1 kHz", "p99 of the control period at most 1.5 times the quiet one", 4, 1, 1.5, "quiet p99"
    ),
    "hostile messages": Promise(
        "messages with hostile values on every input", "all nodes live, outputs finite", 100_000, 1000, unit="message"
    ),
    "mutated bodies": Promise(
        "messages with mutated CDR bodies on every input", "all nodes live, outputs finite", 10_000, 300, unit="message"
    ),
    "long calls": Promise(
        "parameter calls of 10 MB (lists, texts, names) or with 5000 parameters",
        "others are answered within 0.5 s",
        80,
        8,
        0.5,
    ),
    "parameter files": Promise(
        "missing, misspelt, huge and odd parameter files", "status 1, one line that names file and reason", 28, 4
    ),
    "signal with a large file": Promise(
        "SIGINT or SIGTERM while a node starts with 256 kB of unknown parameters", "it ends within 2 s", 30, 1, 2.0
    ),
    "journal bits": Promise(
        "a flipped bit in the journal of a campaign", "refused and left alone, or the same results", 3000, 60
    ),
    "files of others": Promise(
        "state and goal files that others could have written, links, pipes", "not used, with the reason", 12, 12
    ),
    "hostile calls": Promise(
        "parameter calls with hostile names, types and values",
        "all are answered; all nodes live",
        3000,
        60,
        unit="call",
    ),
    "page requests": Promise(
        "hostile connections and requests to the page of `diffbot watch`, some left open",
        "another browser is shown the newest pose; no line in the log",
        2000,
        60,
        unit="request",
    ),
    "page numbers": Promise(
        "messages with hostile numbers to the page", "browsers are shown the newest pose", 2000, 40, unit="message"
    ),
    "page names": Promise(
        "1,000 names of nodes in a message on /diagnostics, all new",
        "at most 100 are on the page, which says how many were dropped; memory grows by 20 MB at most",
        120,
        3,
        20.0,
        "MB",
    ),
    "mutated bags": Promise(
        "bags cut off, with flipped bits, other numbers and repeated bytes, each read by every command on bags",
        _BAGS,
        10_000,
        15,
        5.0,
    ),
    "crafted bags": Promise(
        "bombs, endless records, evil names, extreme values, links and pipes, read by every command on bags",
        _BAGS,
        0,
        0,
        5.0,
    ),
    "recorded bag": Promise("a bag that is being recorded, read by every command on bags", _BAGS, 1, 1, 5.0),
    "replayed bags": Promise(
        "the same bags, replayed", "no traceback, no death, within 5 s of processor time and 400 MB", 100, 2, 5.0
    ),
    "disk full": Promise(
        "the disk is full while recording", "status 1, one ERROR, what was written is readable", 10, 2
    ),
    "end controller": Promise("SIGINT or SIGTERM to the controller", f"{_END}", 20, 1, 2.0),
    "end controller, stop": Promise(
        "SIGINT or SIGTERM to the driving controller", "zero received on cmd_vel within 0.2 s", 20, 1, 0.2
    ),
    "end, last command": Promise(
        "SIGINT and SIGTERM to a node of a driving robot, four busy loops beside it",
        "status 0, and the last command received is zero",
        200,
        1,
    ),
    "end controller, reader stopped": Promise(
        "SIGINT or SIGTERM to the controller while a reader of cmd_vel is held up", f"{_END}, zero received", 10, 1, 2.0
    ),
    "end ekf": Promise("SIGINT or SIGTERM to ekf", _END, 20, 1, 2.0),
    "end plant": Promise("SIGINT or SIGTERM to the plant", _END, 20, 1, 2.0),
    "end recorder": Promise("SIGINT or SIGTERM to the recorder", f"{_END}, the bag is closed", 20, 1, 2.0),
    "end robot": Promise("SIGINT or SIGTERM to robot_node", f"{_END}, zero received", 20, 1, 2.0),
    "end at start": Promise("SIGINT or SIGTERM while a node starts", _END, 50, 1, 2.0),
}
