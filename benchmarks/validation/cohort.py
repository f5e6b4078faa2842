"""Claim: a cohort of generated patients matches the published population, and every wall is valid.

Measures each patient's organs on their courses and walls, then makes whole tracts, whose
generator rejects a wall that intersects itself, and searches for open edges. Results are kept in
`--store`, so that an interrupted run resumes. For example, in two processes:
``python -m benchmarks.validation.cohort --patients 100 --tracts 100 --processes 2``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.common.scripts import ROOT, table, write_section
from vrcaps.anatomy.colon.course import count_flexures
from vrcaps.anatomy.full_tract import FULL_TRACT_COLON_TRIANGLES, generate_full_tract
from vrcaps.anatomy.full_tract.patient import (
    draw_colon_placement,
    draw_patient_anatomy,
    make_neighboring_organs,
    place_stomach,
)
from vrcaps.anatomy.small_bowel import lay_small_bowel
from vrcaps.anatomy.small_bowel.shape import SmallBowelWall
from vrcaps.anatomy.stomach.shape import (
    curvatures,
    draw_stomach_wall,
    stomach_course,
    stomach_volume,
    stomach_wall_rng,
)
from vrcaps.anatomy.tube_mesh.tube import make_tube
from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, MM
from vrcaps.organ.measure import measure_organ

PAGE = ROOT / "docs" / "concepts" / "anatomy.md"
_TITLE = """# Anatomy of generated patients

The script named above each table writes it; nobody types results.
"""
_LITER = 1e-3
_LEVEL = 0.01


@dataclass(frozen=True)
class Published:
    """A quantity in the literature.

    Attributes:
        text: As the table prints it, with its source.
        mean: Mean in the unit of the quantity; None if only a range or a mean is known.
        deviation: In the same unit.
    """

    text: str
    mean: float | None = None
    deviation: float | None = None


_CRONIN = "Cronin 2010, n = 65"
PUBLISHED = {
    "colon length [m]": Published("1.895 ± 0.263 (Khashab 2009, n = 505)", 1.895, 0.263),
    "colon acute flexures": Published("10.9 ± 2.4 (Khashab 2009)", 10.9, 2.4),
    "small bowel length [m]": Published("3 to 4 in life (Steinbrück 2014)", 3.5, 0.25),
    "duodenum length [cm]": Published("25 (Steinbrück 2014)", 25.0),
    "duodenum diameter [mm]": Published(f"24.8 ± 4.5 ({_CRONIN})", 24.8, 4.5),
    "jejunum diameter [mm]": Published(f"24.5 ± 4.2 ({_CRONIN})", 24.5, 4.2),
    "proximal ileum diameter [mm]": Published(f"19.5 ± 3.6 ({_CRONIN})", 19.5, 3.6),
    "distal ileum diameter [mm]": Published(f"18.9 ± 4.2 ({_CRONIN})", 18.9, 4.2),
    "terminal ileum diameter [mm]": Published(f"18.7 ± 3.6 ({_CRONIN})", 18.7, 3.6),
    "jejunum folds per 2.5 cm": Published("4.6 (Cronin 2010)", 4.6),
    "terminal ileum folds per 2.5 cm": Published("1.5 (Cronin 2010)", 1.5),
    "stomach volume, inflated [l]": Published("1 to 1.5 (textbooks)"),
    "stomach volume, normal [l]": Published(""),
    "stomach volume, collapsed [l]": Published(""),
    "greater curvature, inflated [cm]": Published(""),
    "greater curvature, collapsed [cm]": Published("25 to 30 (textbooks); 22.2 ± 3.1 resected"),
    "lesser curvature, inflated [cm]": Published("16.3 ± 2.6 (851 resected, fixed)"),
    "lesser curvature, collapsed [cm]": Published(""),
}

_TEXT = """## Cohort

`python -m benchmarks.validation.cohort --patients {patients} --tracts {tracts}`: seeds 0 to
{last}, each one patient (`vrcaps organ make full-tract --seed N`); {failed}. The courses and
walls that are made are measured, not the parameters. *Mean* and *variance* are the two-sided
probabilities of a sample this far off, or farther, from a normal population of the published mean
and deviation (z test of the mean, χ² test of the variance); a quantity *agrees* where both are
above {level:g}.

{measures}

The small bowel is drawn 3.5 ± 0.25 m long, so that 95 % lie within the published range.
Resected stomachs are measured fixed and flat; in generated ones the greater curvature is longer
and the lesser one shorter, as textbooks have it (Gray's Anatomy: four to five times as long).
"""
_SOUND = """### Walls

Full tracts, all three organs as one wall. The generator draws a wall again until no two triangles
intersect, and otherwise ends with an error. *Seeds* says how many were tried, *defects* counts
open, non-manifold and doubled edges, stray parts, and triangles of a quality below 0.1. CPU seconds
are the median, least and most.

{walls}
"""


def measure(seed: int, distension: str | None = None) -> dict[str, float]:
    """One patient's measures, from the generated courses and walls."""
    patient = draw_patient_anatomy(seed, distension)
    colon = draw_colon_placement(patient.colon, seed)
    axis = place_stomach(patient.stomach, colon, seed)
    around = make_neighboring_organs(colon, patient.stomach, axis)
    wall, tube = lay_small_bowel(patient.small_bowel, around, np.random.default_rng([seed, 3]))
    return {
        "colon length [m]": float(colon.course.arc_length[-1]),
        "colon acute flexures": float(count_flexures(colon.course)),
        "small bowel length [m]": float(tube.arc_length[-1]),
        **_bowel_figures(wall),
        **_stomach_figures(seed),
    }


def _bowel_figures(wall: SmallBowelWall) -> dict[str, float]:
    """Diameters of the smooth wall, and folds, by location."""
    p, folds = wall.parameters, wall.folds.arc_length
    ileum = p.length - 0.6 * (p.length - p.duodenum_length)
    places = {
        "duodenum": 0.5 * p.duodenum_length,
        "jejunum": p.duodenum_length + 40 * CM,
        "proximal ileum": ileum + 0.2 * (p.length - ileum),
        "distal ileum": p.length - 40 * CM,
        "terminal ileum": p.length - 3 * CM,
    }
    measures = {"duodenum length [cm]": p.duodenum_length / CM}
    for name, s in places.items():
        measures[f"{name} diameter [mm]"] = 2.0 * float(wall.envelope(np.array([s]))[0]) / MM
    stretches = {
        "jejunum": (40 * CM, 90 * CM),
        "terminal ileum": (p.length - 15 * CM, p.length - 3 * CM),
    }
    for name, (low, high) in stretches.items():
        count = np.sum((folds > low) & (folds < high))
        measures[f"{name} folds per 2.5 cm"] = float(count / (high - low) * 2.5 * CM)
    return measures


def _stomach_figures(seed: int) -> dict[str, float]:
    """Volume and curvatures of the stomach at each filling."""
    measures = {}
    for distension in ("inflated", "normal", "collapsed"):
        parameters = draw_patient_anatomy(seed, distension).stomach
        tube = make_tube(stomach_course(parameters, np.random.default_rng([seed, 2])))
        wall = draw_stomach_wall(parameters, tube, stomach_wall_rng(seed))
        greater, lesser = curvatures(wall)
        measures[f"greater curvature, {distension} [cm]"] = greater / CM
        measures[f"lesser curvature, {distension} [cm]"] = lesser / CM
        measures[f"stomach volume, {distension} [l]"] = stomach_volume(wall) / _LITER
    return measures


def make(seed: int, distension: str | None = None) -> dict[str, float]:
    """Make one patient's tract and search for defects."""
    patient = draw_patient_anatomy(seed, distension)
    start = time.process_time()
    colon = replace(patient.colon, triangles=FULL_TRACT_COLON_TRIANGLES)
    organ = generate_full_tract(patient.stomach, patient.small_bowel, colon, seed=seed)
    seconds = time.process_time() - start
    facts = measure_organ(organ)
    return {
        "triangles": facts.num_faces,
        "quality": facts.quality_mean,
        "defects": len(facts.defects),
        "length": facts.length,
        "seconds": seconds,
    }


def run(jobs: list[tuple[str, int, str | None]], store: Path, processes: int) -> None:
    """Compute the results missing in the store, and append them, one per line."""
    done = {(line["kind"], line["seed"], line["distension"]) for line in read(store)}
    todo = [job for job in jobs if job not in done]
    store.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(processes) as pool, store.open("a", encoding="utf-8") as file:
        for line in pool.map(_one, todo):
            file.write(json.dumps(line) + "\n")
            file.flush()
            print(json.dumps(line), flush=True)


def read(store: Path) -> Iterator[dict]:
    """Results of previous runs."""
    if store.exists():
        yield from map(json.loads, store.read_text(encoding="utf-8").splitlines())


def _one(job: tuple[str, int, str | None]) -> dict:
    kind, seed, distension = job
    verbs: dict[str, Callable[[int, str | None], dict[str, float]]] = {
        "measure": measure,
        "make": make,
    }
    line = {"kind": kind, "seed": seed, "distension": distension}
    try:
        return {**line, "measures": verbs[kind](seed, distension)}
    except InputError as error:
        return {**line, "error": str(error)}


def figures_table(measured: list[dict[str, float]]) -> str:
    """Cohort compared with the published population."""
    rows = []
    for name, published in PUBLISHED.items():
        values = np.array([measures[name] for measures in measured])
        mean, deviation = values.mean(), values.std(ddof=1)
        chances = ["", ""]
        verdict = ""
        if published.mean is not None and published.deviation is not None:
            chances = [
                f"{p:.2f}" for p in probabilities(values, published.mean, published.deviation)
            ]
            both = probabilities(values, published.mean, published.deviation)
            verdict = "agrees" if min(both) > _LEVEL else "differs"
        span = f"{values.min():.3g} to {values.max():.3g}"
        rows.append(
            (name, published.text, f"{mean:.4g} ± {deviation:.3g}", span, *chances, verdict)
        )
    head = ("quantity", "published", "cohort", "least to greatest", "mean", "variance", "")
    return table(head, rows)


def probabilities(values: np.ndarray, mean: float, deviation: float) -> tuple[float, float]:
    """Two-sided p-values of the mean and of the variance of a sample."""
    num = len(values)
    z = (values.mean() - mean) / (deviation / num**0.5)
    ratio = (num - 1) * values.var(ddof=1) / deviation**2
    below, above = stats.chi2.cdf(ratio, num - 1), stats.chi2.sf(ratio, num - 1)
    return float(2.0 * stats.norm.sf(abs(z))), float(2.0 * min(below, above))


def walls_table(lines: list[dict]) -> str:
    """Organs at each distension, and their defects."""
    rows = []
    for distension in (None, "inflated", "collapsed"):
        chosen = [line for line in lines if line["distension"] == distension]
        made = [line["measures"] for line in chosen if "measures" in line]
        if not chosen:
            continue
        seconds = np.array([measures["seconds"] for measures in made])
        rows.append(
            (
                distension or "usual",
                f"{len(chosen)} of 0 to {max(line['seed'] for line in chosen)}",
                str(len(made)),
                str(sum(measures["defects"] > 0 for measures in made)),
                f"{np.mean([measures['triangles'] for measures in made]):,.0f}",
                f"{np.mean([measures['quality'] for measures in made]):.3f}",
                f"{np.median(seconds):.0f} ({seconds.min():.0f} to {seconds.max():.0f})",
            )
        )
    head = (
        "distension",
        "seeds",
        "without self-intersection",
        "with defects",
        "triangles",
        "quality",
        "CPU s",
    )
    return table(head, rows)


def main() -> None:
    """Measure, make and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patients", type=int, default=100, help="patients to measure")
    parser.add_argument("--tracts", type=int, default=0, help="of them to make whole")
    parser.add_argument(
        "--distensions", type=int, default=0, help="of them to make full and empty too"
    )
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--store", type=Path, default=ROOT / "build" / "cohort.jsonl")
    parser.add_argument("--stored", action="store_true", help="write what is in the store, no more")
    parser.add_argument("--out", type=Path, default=PAGE, help="Markdown page to write into")
    given = parser.parse_args()
    jobs: list[tuple[str, int, str | None]] = [("measure", k, None) for k in range(given.patients)]
    jobs += [("make", k, None) for k in range(given.tracts)]
    for distension in ("inflated", "collapsed"):
        jobs += [("make", k, distension) for k in range(given.distensions)]
    if not given.stored:
        run(jobs, given.store, given.processes)
    lines = [x for x in read(given.store) if (x["kind"], x["seed"], x["distension"]) in jobs]
    measured = [x for x in lines if x["kind"] == "measure"]
    failed = [f"seed {x['seed']}: {x['error'].rstrip('.')}" for x in measured if "error" in x]
    text = _TEXT.format(
        patients=given.patients,
        tracts=given.tracts,
        last=given.patients - 1,
        failed="; ".join(failed) or "all of them could be laid out",
        level=_LEVEL,
        measures=figures_table([x["measures"] for x in measured if "measures" in x]),
    )
    made = [x for x in lines if x["kind"] == "make"]
    if made:
        text += "\n" + _SOUND.format(walls=walls_table(made))
    write_section(given.out, Path(__file__), text, title=_TITLE)


if __name__ == "__main__":
    main()
