"""Claim: every generated colon is valid, and the cohort matches the published population.

Length and flexures against 1.895 ± 0.263 m and 10.9 ± 2.4 (Khashab et al. 2009, Endoscopy
41:674). Run with the number of seeds: ``python -m benchmarks.validation.generated_colons 10``.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from vrcaps.anatomy.colon import ColonParameters, generate_colon
from vrcaps.anatomy.colon.course import count_flexures
from vrcaps.anatomy.tube_mesh.tube import Course
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.organ.measure import triangle_quality


def main(num_seeds: int) -> None:
    """Print a row for each seed and the cohort's means."""
    print("| seed | length m | flexures | triangles | quality mean / 5 % / least | cuts | CPU s |")
    print("|---|---|---|---|---|---|---|")
    lengths, flexures = [], []
    for seed in range(num_seeds):
        parameters = ColonParameters.draw(np.random.default_rng([seed, 1]))
        start = time.process_time()
        organ = generate_colon(parameters, seed=seed)
        seconds = time.process_time() - start
        quality = triangle_quality(Mesh(organ.vertices, organ.faces))
        line = organ.centerline
        lengths.append(line.length)
        flexures.append(count_flexures(Course(line.points, line.arc_length)))
        cuts = len(self_intersections(organ.vertices, organ.faces))
        print(
            f"| {seed} | {line.length:.3f} | {flexures[-1]} | {len(organ.faces)} "
            f"| {quality.mean():.3f} / {np.percentile(quality, 5):.2f} / {quality.min():.2f} "
            f"| {cuts} | {seconds:.1f} |",
            flush=True,
        )
    print(
        f"\nlength {np.mean(lengths):.3f} ± {np.std(lengths):.3f} m, "
        f"flexures {np.mean(flexures):.1f} ± {np.std(flexures):.1f}"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
