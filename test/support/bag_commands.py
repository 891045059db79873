"""Every command that reads a bag, run in a forked process with bounds of memory and of processor time."""

import argparse
import contextlib
import functools
import hashlib
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from unittest import mock

from diffbot_tools import cli

MEMORY = 300 * 2**20
"""[bytes] more than before"""
CPU = 5.0
"""[s] of a command"""
PARAMETERS = "/ekf:\n  ros__parameters:\n    wheel_radius: 0.1\n    wheel_separation: 0.4\n"
CONTRACT = "version: 1\nbag: {max_lost: 0}\ntopics: {/odom: {min_rate: 1.0, max_gap: 1.0, stamped: true}}\n"
ARGUMENTS = {
    "bag info": [["{bag}"], ["{bag}", "--json"]],
    "bag check": [["{bag}", "{given}/contract.yaml", "--json"], ["{bag}", "--write", "{out}.yaml"]],
    "bag repair": [["{bag}", "{out}"], ["{copy}", "--in-place"]],
    "bag trim": [["{bag}", "{out}", "--from", "0.1s", "--to", "end-0.1s"]],
    "bag filter": [["{bag}", "{out}", "--topics", "/odom", "/map"]],
    "bag merge": [["{bag}", "{given}/good", "{out}"]],
    "refilter": [["{bag}", "--params", "{given}/ekf.yaml", "--compare", "/ground_truth", "--out", "{out}"]],
    "calibrate": [["{bag}", "--params", "{given}/ekf.yaml", "--out", "{out}.yaml", "--until", "0.2"]],
    "report": [["{bag}", "-o", "{out}.html", "--csv", "--tum"]],
    "replay": [["{bag}", "--as-fast-as-possible", "--disable-keyboard-controls"]],
}
"""What each command is given; ``copy`` is a copy of the bag that may change, ``out`` does not exist."""
GRAPH = ("replay",)
"""commands that start a node"""
BASE = 100 * 2**20
"""[bytes] of a process with a node"""


def bag_commands():
    """Return the names of the commands with a bag among their arguments, as the command line itself lists them."""
    return {name for name, parser in leaves(cli._parser()) if {one.dest for one in parser._actions} & {"bag", "bags"}}


def leaves(parser, words=()):
    """Yield the name and the parser of each command."""
    below = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    for one in below:
        for name, child in one.choices.items():
            yield from leaves(child, (*words, name))
    if not below:
        yield " ".join(words), parser


@functools.cache
def _parser():
    """Return the parser, which takes longer to make than most commands on a small bag."""
    return cli._parser()


def state_of(path):
    """Return what a bag is: each file with a digest of its content."""
    files = [path, *sorted(path.rglob("*"))] if path.is_dir() and not path.is_symlink() else [path]
    return [(str(one), _digest(one)) for one in files if os.path.lexists(one)]


def _digest(path):
    if _is_plain(path):
        return hashlib.sha256(path.read_bytes()).digest()
    found = path.lstat()
    return found.st_mode, found.st_ino


def _is_plain(path):
    return path.is_file() and not path.is_symlink() and os.access(path, os.R_OK)


def run(arguments):
    """Run the command line in this process; return its status, what it printed, and the processor time [s]."""
    out, err = io.StringIO(), io.StringIO()
    _parser()  # made now, and not where it is replaced
    begin = time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            with mock.patch.object(cli, "_parser", _parser):
                status = cli.main(arguments)
        except SystemExit as error:
            status = error.code
        except BaseException:
            traceback.print_exc()
            status = 99
    return status, out.getvalue(), err.getvalue(), time.process_time() - begin


def problems_of(bag, given, names, folder):
    """Run commands on a bag, with outputs in a new folder; return each, what is wrong with it, and its time [s]."""
    found = []
    for name in names:
        for number, template in enumerate(ARGUMENTS[name]):
            work = folder / f"{name} {number}".replace(" ", "_")
            work.mkdir(parents=True)
            copy = _copy(bag, work) if "{copy}" in template else bag
            before = state_of(bag)
            words = [word.format(bag=bag, copy=copy, given=given, out=work / "out") for word in template]
            result = run([*name.split(), *words])
            complaint = complaint_about(*result)
            if state_of(bag) != before:
                complaint = complaint or "the input was changed"
            left = [path.name for path in work.iterdir() if path != copy]
            is_checked = name == "bag check" and result[0] == 1
            if left and result[0] != 0 and not is_checked:
                complaint = complaint or f"status {result[0]}, and left {left}"
            if any(".part" in path.name for path in work.rglob("*")):
                complaint = complaint or "a hidden part was left"
            found.append((f"{name} {number}", complaint, result[3]))
            shutil.rmtree(work)
    return found


def _copy(bag, work):
    copy = work / bag.name
    if bag.is_dir():
        # A pipe cannot be copied.
        with contextlib.suppress(shutil.Error):
            shutil.copytree(bag, copy, symlinks=True)
    elif _is_plain(bag):
        shutil.copyfile(bag, copy)
    return copy


def complaint_about(status, out, err, seconds):
    """Return what is wrong with the end of a command; empty if nothing is."""
    if "Traceback" in err or status not in (0, 1, 2):
        return f"status {status}: " + " | ".join(err.strip().splitlines()[-6:])[-900:]
    if "MemoryError" in out + err:
        return f"memory: {err[-300:]}"
    if seconds > CPU:
        return f"{seconds:.1f} s of processor time"
    lines = [line for line in err.splitlines() if line.startswith("diffbot")]
    refusals = [line for line in lines if "warning:" not in line]
    if status and not out and len(refusals) != 1:
        return f"status {status}, and {len(refusals)} lines of refusal: {err[-300:]}"
    shown = [line for line in (out + err).splitlines() if not line.isprintable() and "\r" not in line]
    if shown or max(map(len, refusals), default=0) > 1500:
        return f"prints {(shown or refusals)[0][:200]!r}"
    return ""


def in_fork(work, seconds):
    """Return what ``work`` returns in a fork with bounds of MEMORY and of processor time [s]; a text if it died."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        status = 1
        try:
            size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 1))
            with os.fdopen(writing, "w") as stream:
                json.dump(work(), stream)
            status = 0
        finally:
            os._exit(status)
    os.close(writing)
    with os.fdopen(reading) as stream:
        content = stream.read()
    _, status = os.waitpid(child, 0)
    if status or not content:
        killed = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        return f"died: {signal.Signals(killed).name if killed else status}"
    return json.loads(content)


_USAGE = """
import json, resource, subprocess, sys
status = subprocess.call(sys.argv[1:], stdout=sys.stderr)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([status, used.ru_utime + used.ru_stime, used.ru_maxrss]))
"""
"""Runs a command and says what it used; of a large process, its memory would count as that of its children."""


def replayed(bag):
    """Replay a bag in a process of its own; return what is wrong with that, and its processor time [s]."""
    words = [word.format(bag=bag) for word in ARGUMENTS["replay"][0]]
    with tempfile.TemporaryFile("w+") as output:
        command = [sys.executable, "-m", "diffbot_tools.cli", "replay", *words]
        done = subprocess.run(
            [sys.executable, "-c", _USAGE, *command], stdout=subprocess.PIPE, stderr=output, check=True
        )
        output.seek(0)
        text = output.read()
    status, seconds, memory = json.loads(done.stdout)
    if memory * 1024 > BASE + MEMORY:
        return f"{memory} kB of memory", seconds
    return complaint_about(status, "", text if "Traceback" in text else "diffbot: ", seconds), seconds
