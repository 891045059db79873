"""``diffbot stability level`` and ``verify``: the enclosure, its file, and mistakes planted in it."""

import base64
import json
import re
import zlib

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab import cli
from diffbot_lab.stability.level.enclosure import find_level, find_witness, problem_of
from diffbot_lab.stability.level.file import LevelCertificate, load_level
from diffbot_lab.stability.level.verify import verify_level
from diffbot_lab.stability.level.witness import levels

RHO_MAX = 8.0


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("level") / "new" / "level.json"
    assert cli.main(["stability", "level", "--rho-max", "8", "--tolerance", "0.01", "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def certificate(file):
    return load_level(file)


def test_the_level_of_the_paper_is_enclosed(certificate):
    before, after = levels(certificate.witness, certificate.problem)
    assert 19.0 < before < after < certificate.level < 19.4
    assert certificate.problem == problem_of({})
    verify_level(certificate)


def test_the_exact_arc_has_a_level_of_its_own():
    problem = problem_of({"exact_arc": True})
    witness = find_witness(problem, RHO_MAX, np.random.default_rng(1))
    level, tree = find_level(problem, RHO_MAX, 0.01, witness)
    assert 18.3 < levels(witness, problem)[0] < level < 18.8
    verify_level(LevelCertificate(problem, RHO_MAX, level, tree, witness))


def test_the_command_says_what_is_shown_and_verify_agrees(file, capsys):
    assert cli.main(["stability", "verify", str(file)]) == 0
    text = capsys.readouterr().out
    level = json.loads(file.read_text())["level"]
    shown, distance = re.search(
        r"within 8 m, V decreases in each step while V > (.*);\n.* at most (.*) m", text
    ).groups()
    # Rounded up: what is printed is shown, too.
    assert level <= float(shown) < level + 1e-4
    assert np.sqrt(2.0 * level) <= float(distance) < np.sqrt(2.0 * level) + 1e-4
    assert "Verified: " in text


def subtree_sizes(tree):
    """Number of nodes of the subtree that begins at each node."""
    sizes, waiting = np.ones(len(tree), int), []
    for at in range(len(tree) - 1, -1, -1):
        if tree[at]:
            sizes[at] += waiting.pop() + waiting.pop()
        waiting.append(sizes[at])
    return sizes


def cut_out(tree):
    """Put one leaf in place of a subtree of so many cells that halving the leaf a few times does not show it."""
    sizes = subtree_sizes(tree)
    start = int(np.where(sizes < len(tree) // 3, sizes, 0).argmax())
    return np.concatenate([tree[:start], [np.uint8(0)], tree[start + sizes[start] :]])


def put_in_other_order(tree):
    """Exchange the halves of the root."""
    middle = 1 + subtree_sizes(tree)[1]
    return np.concatenate([tree[:1], tree[middle:], tree[1:middle]])


TREES = {
    "a part is cut out": (cut_out, "is not shown: rho "),
    "leaves are replaced": (put_in_other_order, "is not shown: rho "),
    "the end is missing": (lambda tree: tree[:-5], "cells left out"),
    "a node too many": (lambda tree: np.append(tree, np.uint8(0)), "is wrong: byte 0, 0 cells"),
    "an unknown byte": (lambda tree: np.where(np.arange(len(tree)) == 500, 9, tree).astype(np.uint8), "node 500 is"),
    "halved without end": (lambda tree: np.ones(1000, np.uint8), "node 255 is wrong: byte 1"),
}


@pytest.mark.parametrize("name", TREES)
def test_a_mistake_planted_in_the_tree_is_found(name, certificate):
    change, message = TREES[name]
    with pytest.raises(DiffbotError, match=message):
        verify_level(certificate._replace(tree=change(certificate.tree)))


def test_mistakes_planted_in_the_claim_are_found(certificate):
    before, _ = levels(certificate.witness, certificate.problem)
    witness = certificate.witness
    with pytest.raises(DiffbotError, match="must be <= level"):
        verify_level(certificate._replace(level=0.999 * before))
    with pytest.raises(DiffbotError, match="is not shown"):
        verify_level(certificate._replace(level=0.999 * before, witness=None))
    with pytest.raises(DiffbotError, match="must be < rho_max"):
        verify_level(certificate._replace(rho_max=6.0))
    with pytest.raises(DiffbotError, match="is not shown"):
        verify_level(certificate._replace(problem=certificate.problem._replace(eps_theta=0.2)))
    with pytest.raises(DiffbotError, match=r"eps_theta = 0\.3"):
        verify_level(certificate._replace(witness=witness._replace(eps_theta=0.3)))
    with pytest.raises(DiffbotError, match="must increase"):
        verify_level(certificate._replace(witness=witness._replace(rho=witness.rho + 0.1)))
    with pytest.raises(DiffbotError, match="rho = 9"):
        verify_level(certificate._replace(witness=witness._replace(rho=9.0)))


def test_simulation_finds_a_claim_that_a_wrong_bound_would_show(certificate, monkeypatch):
    monkeypatch.setattr("diffbot_lab.stability.level.verify._check_tree", lambda *arguments: None)
    with pytest.raises(DiffbotError, match="a simulated step breaks the claim"):
        verify_level(certificate._replace(level=4.0, witness=None))


BAD = {
    "no text as format": ({"format": [1]}, "format = '[1]': must be one of"),
    "other format": ({"format": "other"}, "format = 'other': must be one of 'diffbot stability level 1'"),
    "rho_max": ({"rho_max": -1.0}, "rho_max = -1.0: must be from"),
    "level": ({"level": "high"}, "level = 'high': must be from"),
    "no level": ({"level": None}, "level = None: must be from"),
    "infinite": ({"level": float("inf")}, "level = inf: must be from"),
    "nan": ({"rho_max": float("nan")}, "rho_max = nan: must be from"),
    "nodes": ({"nodes": 10**12}, "nodes = 1000000000000: must be"),
    "other nodes": ({"nodes": 7}, "tree: must hold 7 bytes"),
    "tree": ({"tree": "%%"}, "tree: "),
    "no text": ({"tree": 5}, "tree: must be a text"),
    "a bomb": ({"tree": base64.b64encode(zlib.compress(bytes(10**8))).decode()}, "tree: must hold"),
    "problem": ({"problem": [1]}, "problem: must have the fields gamma"),
    "witness": ({"witness": {"rho": 1}}, "witness: must have the fields rho"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_one_line(name, file, tmp_path, capsys):
    change, message = BAD[name]
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(json.loads(file.read_text()) | change))
    assert cli.main(["stability", "verify", str(path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"diffbot: {path}: ")
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("field", "value"),
    [("gamma", 0.0), ("k", True), ("eps_theta", 4.0), ("eps_x", -0.1), ("exact_arc", 1), ("h", None)],
)
def test_a_bad_problem_names_its_field(field, value, file, tmp_path, capsys):
    content = json.loads(file.read_text())
    content["problem"][field] = value
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content))
    assert cli.main(["stability", "verify", str(path)]) == 1
    assert f"{field} = {value!r}: must be" in capsys.readouterr().err


def test_what_is_no_certificate_is_one_line(tmp_path, capsys):
    (tmp_path / "text").write_bytes(b"\xff\xfe{")
    for path in (tmp_path, tmp_path / "none", tmp_path / "text"):
        assert cli.main(["stability", "verify", str(path)]) == 1
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "status", "part"),
    [
        (["--tolerance", "0"], 2, "--tolerance"),
        (["--rho-max", "nan"], 2, "--rho-max"),
        (["--set", "drive_noise=0.1"], 1, "drive_noise = 0.1: must be left out"),
        (["--set", "eps_theta_max=4"], 1, "eps_theta_max = 4"),
        (["--rho-max", "3"], 1, "no level is shown within 3 m"),
    ],
)
def test_refused_in_one_line(arguments, status, part, tmp_path, capsys):
    out = tmp_path / "level.json"
    try:
        found = cli.main(["stability", "level", "--out", str(out), *arguments])
    except SystemExit as end:
        found = end.code
    assert found == status
    assert part in capsys.readouterr().err.strip().splitlines()[-1]
    assert not out.exists()
