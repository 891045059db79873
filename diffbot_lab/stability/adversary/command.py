"""``diffbot stability adversary``: chosen and random noise against a certificate."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.stability.adversary import paper_play, tuned_play
from diffbot_lab.stability.adversary.drift import drift_of
from diffbot_lab.stability.adversary.figure import NearField, draw_near_field, field_of_paper, field_of_tuned
from diffbot_lab.stability.adversary.observe import Observed, observe
from diffbot_lab.stability.adversary.search import Attack, Play, search
from diffbot_lab.stability.paper import command as paper
from diffbot_lab.stability.paper.file import load_certificate
from diffbot_lab.stability.result_file import read_result
from diffbot_lab.stability.tuned import command as tuned
from diffbot_lab.stability.tuned.file import FORMAT, load_tuned
from diffbot_lab.stability.tuned.runs import loop_of

_GENERATIONS = 40
_SPREAD_OF_PAPER, _SPREAD_OF_TUNED = 0.8, 0.3
"""[m] starts of the adversary"""


class Target(NamedTuple):
    """A certificate, and what attacks it."""

    report: str
    claims: dict[str, Any]
    loop: dict[str, Any]
    play: Play
    spread: float
    """[m] starts of the adversary"""
    drift: float
    """[m] what a slow drift in Omega_L or a lured V reaches; 0: not tried"""
    observe: Callable[[], Observed]
    field: NearField


def _target(path: Path, steps: int, trajectories: int, seed: int) -> Target:
    if read_result(path).get("format") == FORMAT:
        return _tuned_target(path, steps, trajectories, seed)
    certificate = load_certificate(path)
    claims, opponent = certificate.claims, paper_play.opponent_of(certificate.loop)
    return Target(
        paper.report(certificate),
        claims._asdict() | {"time": claims.steps * certificate.loop.t_s},
        certificate.loop._asdict(),
        lambda start, weights: paper_play.play(opponent, start, weights),
        _SPREAD_OF_PAPER,
        0.0,
        lambda: observe(certificate, steps, trajectories, seed),
        field_of_paper(certificate),
    )


def _tuned_target(path: Path, steps: int, trajectories: int, seed: int) -> Target:
    certificate = load_tuned(path)
    claims, loop, period = certificate.claims, loop_of(certificate), certificate.plan.period
    return Target(
        tuned.report(certificate),
        claims._asdict() | {"time": claims.steps * period},
        certificate.plan.contract._asdict(),
        lambda start, weights: tuned_play.play_tuned(loop, start, weights),
        _SPREAD_OF_TUNED,
        drift_of(loop).farthest,
        lambda: tuned_play.observe_tuned(certificate, steps, trajectories, seed),
        field_of_tuned(certificate, period),
    )


def run_adversary(path: Path, steps: int, trajectories: int, seed: int, out: Path) -> int:
    """Attack a certificate: search noise that keeps the robot away, and simulate random noise.

    Args:
        path: of the certificate.
        steps: of random noise from the core.
        trajectories: of random noise from all over the start.
        seed: of both.
        out: folder for adversary.json and adversary.png.

    Raises:
        DiffbotError: if the certificate is refuted, after writing the files, or they cannot be written.
    """
    target = _target(path, steps, trajectories, seed)
    radius = float(target.claims["radius"])
    with output_folder(out):
        with tqdm(desc="adversary", total=_GENERATIONS, unit="generation", disable=None) as bar:
            attack = search(target.play, target.spread, seed, _GENERATIONS, each=lambda best: _shown(bar, best))
        seen = target.observe()
        distance = max(attack.distance, target.drift)
        result = _result(target, attack, seen, distance, seed)
        write_json(out / "adversary.json", result)
        draw_near_field(target.field, attack.path, seen.cloud, out / "adversary.png")
    print(target.report)
    print(json.dumps({key: result[key] for key in ("certified_over_adversary", "observed")}))
    print(f"An adversary brings the robot to {distance:.3f} m.\n{out / 'adversary.json'}\n{out / 'adversary.png'}")
    if seen.left_core or seen.late or distance > radius:
        raise DiffbotError(f"{path}: refuted, {seen.left_core} steps left the core, {seen.late} trajectories were late")
    return 0


def _result(target: Target, attack: Attack, seen: Observed, distance: float, seed: int) -> dict[str, Any]:
    adversary: dict[str, Any] = {"distance": distance, "again_and_again": attack.distance, "drift": target.drift}
    return {
        "certified": target.claims,
        "adversary": adversary | {"weights": attack.weights.tolist()},
        "certified_over_adversary": float(target.claims["radius"]) / distance,
        "observed": {key: value for key, value in seen._asdict().items() if key != "cloud"},
        "loop": target.loop,
        "seed": seed,
    }


def _shown(bar: Any, best: float) -> None:
    bar.set_postfix(distance=f"{best:.3f} m")
    bar.update()
