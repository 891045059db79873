"""``diffbot stability adversary``: chosen and random errors against a certificate."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.stability.adversary.drift import drift_of
from diffbot_lab.stability.adversary.figure import draw_near_field, field_of
from diffbot_lab.stability.adversary.play import observe, play
from diffbot_lab.stability.adversary.search import search
from diffbot_lab.stability.certificates import report, steps_to_core
from diffbot_lab.stability.file import load_certificate
from diffbot_lab.stability.runs import loop_of

_GENERATIONS = 40
_SPREAD = 0.3
"""[m] starts of the adversary"""


def run_adversary(path: Path, steps: int, trajectories: int, seed: int, out: Path) -> int:
    """Attack a certificate: search errors that keep the robot away, and simulate random ones.

    Args:
        path: of the certificate.
        steps: of random errors from drawn memories, at least.
        trajectories: of random errors from all over the start.
        seed: of both.
        out: folder for adversary.json and adversary.png.

    Raises:
        DiffbotError: if the certificate is refuted, after writing the files, or they cannot be written.
    """
    certificate = load_certificate(path)
    claims, plan, loop = certificate.claims, certificate.plan, loop_of(certificate)
    with output_folder(out):
        with tqdm(desc="adversary", total=_GENERATIONS, unit="generation", disable=None) as bar:
            game = functools.partial(play, loop)
            attack = search(game, _SPREAD, seed, _GENERATIONS, each=lambda best: _shown(bar, best))
        drifted = drift_of(loop).farthest
        distance = max(attack.distance, drifted)
        seen = observe(certificate, steps, trajectories, seed)
        result = {
            "certified": claims._asdict() | {"time": steps_to_core(certificate) * plan.period},
            "adversary": {
                "distance": distance,
                "again_and_again": attack.distance,
                "drift": drifted,
                "weights": attack.weights.tolist(),
            },
            "certified_over_adversary": claims.radius / distance,
            "observed": {key: value for key, value in seen._asdict().items() if key != "cloud"},
            "plan": {**plan._asdict(), "contract": plan.contract._asdict()},
            "law": certificate.law,
            "seed": seed,
        }
        write_json(out / "adversary.json", result)
        draw_near_field(field_of(certificate), attack.path, seen.cloud, out / "adversary.png")
    print(report(certificate))
    print(json.dumps({key: result[key] for key in ("certified_over_adversary", "observed")}))
    print(f"An adversary brings the robot to {distance:.3f} m.\n{out / 'adversary.json'}\n{out / 'adversary.png'}")
    if seen.left_core or seen.late or distance > claims.radius:
        raise DiffbotError(f"{path}: refuted, {seen.left_core} steps left the core, {seen.late} trajectories were late")
    return 0


def _shown(bar: Any, best: float) -> None:
    bar.set_postfix(distance=f"{best:.3f} m")
    bar.update()
