"""``diffbot stability adversary``: chosen and random noise against a certificate of the paper's loop."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.stability.adversary.figure import draw_near_field
from diffbot_lab.stability.adversary.observe import observe
from diffbot_lab.stability.adversary.search import search
from diffbot_lab.stability.paper.command import report
from diffbot_lab.stability.paper.file import load_certificate

_GENERATIONS = 40


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
    certificate = load_certificate(path)
    with output_folder(out):
        with tqdm(desc="adversary", total=_GENERATIONS, unit="generation", disable=None) as bar:
            attack = search(certificate.loop, seed, _GENERATIONS, each=lambda best: _shown(bar, best))
        seen = observe(certificate, steps, trajectories, seed)
        result = {
            "certified": certificate.claims._asdict() | {"time": certificate.claims.steps * certificate.loop.t_s},
            "adversary": {"distance": attack.distance, "weights": attack.weights.tolist()},
            "certified_over_adversary": certificate.claims.radius / attack.distance,
            "observed": {key: value for key, value in seen._asdict().items() if key != "cloud"},
            "loop": certificate.loop._asdict(),
            "seed": seed,
        }
        write_json(out / "adversary.json", result)
        draw_near_field(certificate, attack.path, seen.cloud, out / "adversary.png")
    print(report(certificate))
    print(json.dumps({key: result[key] for key in ("certified_over_adversary", "observed")}))
    print(f"An adversary brings the robot back to {attack.distance:.3f} m again and again.")
    print(f"{out / 'adversary.json'}\n{out / 'adversary.png'}")
    if seen.left_core or seen.late or attack.distance > certificate.claims.radius:
        raise DiffbotError(f"{path}: refuted, {seen.left_core} steps left the core, {seen.late} trajectories were late")
    return 0


def _shown(bar: Any, best: float) -> None:
    bar.set_postfix(distance=f"{best:.3f} m")
    bar.update()
