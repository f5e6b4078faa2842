"""HTML page of an evaluation, with its figure and table as separate files."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vrcaps.core.files import write_bytes, write_csv
from vrcaps.policy.evaluation import PAPER_COVERAGE, PAPER_TIME
from vrcaps.tools.evaluation.subject import MEDIAN_OF, Subject, ends, summary
from vrcaps.tools.evaluation.summary_figure import summary_picture
from vrcaps.tools.html_page import STYLE, data_url, html_table

PAGE, PICTURE, TABLE, VIDEO = "index.html", "summary.png", "summary.csv", "median.mp4"

_NOTE = f"""Coverage: points on the wall that stand for its area; <i>frustum</i> counts vertices
in the field of view through walls (the definition of VR-Caps), <i>visible</i> what nothing hides,
<i>resolved</i> what is also seen close and steeply enough. After the end of an episode its coverage
stays. Lines: mean over episodes with its 95 % confidence band, for which whole organs are drawn
anew 1,000 times (episodes where there is one organ); pale: 10th to 90th percentile.
Star: VR-Caps, {PAPER_COVERAGE} % at {PAPER_TIME} s of one stomach. Times: median over episodes,
where one that never got there counts as the longest, and how many got there. Forces: median over
episodes of percentiles over the actions of an episode."""


def write_page(folder: Path, subjects: Sequence[Subject]) -> list[Path]:
    """Write the page, the figure and the table.

    Args:
        folder: Output folder.
        subjects: Evaluated policies; each has the video of its median run in its folder, if made.

    Returns:
        Paths of the files.
    """
    write_bytes(folder / PICTURE, summary_picture(subjects))
    columns = {subject.name: summary(subject) for subject in subjects}
    names = next(iter(columns.values()))
    rows = [
        {"figure": name, **{subject: column[name] for subject, column in columns.items()}}
        for name in names
    ]
    write_csv(folder / TABLE, rows)
    write_bytes(folder / PAGE, _page(folder, subjects, rows).encode())
    return [folder / name for name in (PAGE, PICTURE, TABLE)]


def _page(folder: Path, subjects: Sequence[Subject], rows: list[dict[str, str]]) -> str:
    dynamics = ", ".join(sorted({subject.settings.dynamics for subject in subjects}))
    by_organ = _by_organ(subjects)
    organs = [row["organ"] for row in by_organ]
    whole = ", ".join(sorted({f"{s.settings.episode_time:g}" for s in subjects}))
    said = (
        f"{len(organs)} organs ({', '.join(organs[:4])}{', …' if len(organs) > 4 else ''}); "
        f"episodes of {whole} s; dynamics: {dynamics}."
    )
    parts = [
        f"<!doctype html><meta charset='utf-8'><title>Evaluation</title><style>{STYLE}</style>",
        f"<h1>Evaluation of {html.escape(', '.join(s.name for s in subjects))}</h1>",
        f"<p>{html.escape(said)}</p>",
        f"<img alt='coverage' src='{data_url((folder / PICTURE).read_bytes(), 'image/png')}'>",
        f"<p class='note'>{_NOTE}</p>",
        html_table(rows),
        "<h2>Organs</h2><p class='note'>Median visible coverage "
        f"at {subjects[0].judged_at:g} s [%].</p>{html_table(by_organ)}",
        f"<h2>Ends of episodes</h2>{html_table(_ends(subjects))}",
    ]
    for subject in subjects:
        video = subject.evaluation.folder / VIDEO
        if video.is_file():
            source = data_url(video.read_bytes(), "video/mp4")
            row = subject.evaluation.median_row(MEDIAN_OF)
            parts.append(
                f"<h2>{html.escape(subject.name)}: the median run</h2>"
                f"<p>{row['organ']}, seed {row['seed']}, episode {row['episode']}; twice as fast "
                "as it was. Left: the camera. Right: the organ, green where it was seen.</p>"
                f"<video controls loop muted src='{source}'></video>"
            )
    return "\n".join(parts)


def _by_organ(subjects: Sequence[Subject]) -> list[dict[str, str]]:
    """One row per organ, one column per subject."""
    names = sorted({str(o) for s in subjects for o in s.evaluation.column("organ")})
    rows = []
    for name in names:
        row = {"organ": name}
        for subject in subjects:
            own = subject.evaluation.column("organ") == name
            percent = subject.evaluation.column(f"visible_at_{subject.judged_at:g}_s")[own]
            row[subject.name] = f"{np.median(percent):.1f}" if len(percent) else ""
        rows.append(row)
    return rows


def _ends(subjects: Sequence[Subject]) -> list[dict[str, str]]:
    """One row per subject: number of episodes by end reason."""
    counts = [ends(subject) for subject in subjects]
    reasons = sorted({reason for count in counts for reason in count})
    return [
        {"policy": subject.name, **{r: str(count.get(r, 0)) for r in reasons}}
        for subject, count in zip(subjects, counts, strict=True)
    ]
