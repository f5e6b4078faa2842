"""Claim: a cohort of generated patients is the published population, and no wall cuts itself.

Prints what is measured on the generated courses and walls beside the published means and
deviations. Every patient's colon, stomach and small bowel is laid out and measured; the walls
of the first few are also meshed as one tract and searched for cuts, which takes longer. Run
with the number of patients and of meshed tracts: ``python benchmarks/cohort.py 100 5``.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from vrcaps.errors import InputError
from vrcaps.organ.colon.course import count_flexures
from vrcaps.organ.crossing import self_intersections
from vrcaps.organ.facts import organ_facts
from vrcaps.organ.gi.abdomen import draw_colon_place, place_stomach, surroundings
from vrcaps.organ.gi.generate import generate_gi
from vrcaps.organ.gi.patient import draw_patient
from vrcaps.organ.shape.tube import make_tube
from vrcaps.organ.small_bowel.generate import lay_small_bowel
from vrcaps.organ.stomach.shape import curvatures, draw_stomach_wall, stomach_volume
from vrcaps.units import CM, MM

_LITRE = 1e-3
_PUBLISHED = {
    "colon length m": "1.895 ± 0.263 (Khashab 2009, n = 505)",
    "colon acute flexures": "10.9 ± 2.4 (Khashab 2009)",
    "stomach volume inflated l": "1 to 1.5 (textbooks)",
    "greater curvature inflated cm": "25 to 30 (textbooks; see StomachParameters)",
    "greater curvature collapsed cm": "22.2 ± 3.1 (851 resected, fixed)",
    "lesser curvature inflated cm": "16.3 ± 2.6 (851 resected, fixed)",
    "small bowel length m": "3 to 4 (Steinbrück 2014)",
    "duodenum length cm": "25 (Steinbrück 2014)",
    "duodenum calibre mm": "24.8 ± 4.5 (Cronin 2010, n = 65)",
    "jejunum calibre mm": "24.5 ± 4.2 (Cronin 2010)",
    "proximal ileum calibre mm": "19.5 ± 3.6 (Cronin 2010)",
    "distal ileum calibre mm": "18.9 ± 4.2 (Cronin 2010)",
    "terminal ileum calibre mm": "18.7 ± 3.6 (Cronin 2010)",
    "jejunum folds per 2.5 cm": "4.6 (Cronin 2010)",
    "terminal ileum folds per 2.5 cm": "1.5 (Cronin 2010)",
}


def measure(seed: int) -> dict[str, float]:
    """One patient's figures, from the generated courses and walls."""
    patient = draw_patient(seed)
    colon = draw_colon_place(patient.colon, seed)
    figures = {
        "colon length m": float(colon.course.arc_length[-1]),
        "colon acute flexures": float(count_flexures(colon.course)),
    }
    for condition in ("inflated", "collapsed"):
        rng = np.random.default_rng([seed, 2])
        parameters = draw_patient(seed, condition).stomach
        axis = place_stomach(parameters, colon, rng)
        wall = draw_stomach_wall(parameters, make_tube(axis), rng)
        greater, lesser = curvatures(wall)
        figures[f"greater curvature {condition} cm"] = greater / CM
        figures[f"lesser curvature {condition} cm"] = lesser / CM
        figures[f"stomach volume {condition} l"] = stomach_volume(wall) / _LITRE
    axis = place_stomach(patient.stomach, colon, np.random.default_rng([seed, 2]))
    bowel, tube = lay_small_bowel(
        patient.small_bowel,
        surroundings(colon, patient.stomach, axis),
        np.random.default_rng([seed, 3]),
    )
    p, folds = patient.small_bowel, bowel.folds.arc_length
    figures["small bowel length m"] = float(tube.arc_length[-1])
    figures["duodenum length cm"] = p.duodenum_length / CM
    places = {
        "duodenum": 0.5 * p.duodenum_length,
        "jejunum": p.duodenum_length + 40 * CM,
        "proximal ileum": p.length - 0.8 * 0.6 * (p.length - p.duodenum_length),
        "distal ileum": p.length - 40 * CM,
        "terminal ileum": p.length - 3 * CM,
    }
    for name, s in places.items():
        figures[f"{name} calibre mm"] = 2.0 * float(bowel.envelope(np.array([s]))[0]) / MM
    for name, low, high in (("jejunum", 40 * CM, 90 * CM), ("terminal ileum", -15 * CM, -3 * CM)):
        start = low if low > 0.0 else p.length + low
        count = np.sum((folds > start) & (folds < start + high - low))
        figures[f"{name} folds per 2.5 cm"] = float(count / (high - low) * 2.5 * CM)
    return figures


def main(num_patients: int, num_meshed: int) -> None:
    """Print the cohort's table and a row for each meshed tract."""
    measured, failed = [], []
    for seed in range(num_patients):
        try:
            measured.append(measure(seed))
        except InputError as error:
            failed.append(f"seed {seed}: {error}")
    print(f"{len(measured)} of {num_patients} patients laid out.", *failed, sep="\n")
    print("\n| figure | published | cohort mean ± deviation | least to greatest |")
    print("|---|---|---|---|")
    names = [*_PUBLISHED, *(name for name in measured[0] if name not in _PUBLISHED)]
    for name in names:
        values = np.array([figures[name] for figures in measured])
        print(
            f"| {name} | {_PUBLISHED.get(name, '')} | {values.mean():.3g} ± {values.std():.2g} "
            f"| {values.min():.3g} to {values.max():.3g} |"
        )
    print("\n| seed | triangles | quality mean / 5 % | defects | cuts | CPU s |")
    print("|---|---|---|---|---|---|")
    for seed in range(num_meshed):
        patient = draw_patient(seed)
        start = time.process_time()
        organ = generate_gi(patient.stomach, patient.small_bowel, patient.colon, seed=seed)
        seconds = time.process_time() - start
        facts = organ_facts(organ)
        cuts = len(self_intersections(organ.vertices, organ.faces))
        print(
            f"| {seed} | {facts.num_faces} | {facts.quality_mean:.3f} / {facts.quality_p5:.2f} "
            f"| {len(facts.defects)} | {cuts} | {seconds:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(
        int(sys.argv[1]) if len(sys.argv) > 1 else 100, int(sys.argv[2]) if len(sys.argv) > 2 else 0
    )
