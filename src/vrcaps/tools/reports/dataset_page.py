"""HTML page of a data set: one self-contained file."""

from __future__ import annotations

import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.files import write_bytes
from vrcaps.data.card import duration_text, size_text
from vrcaps.data.dataset import (
    Count,
    Row,
    by_split,
    count,
    count_by,
    lesion_counts,
    segment_counts,
    shared_organs,
)
from vrcaps.data.plan import DatasetSettings
from vrcaps.data.store import read_at_once
from vrcaps.recording.frame_sequence import SPLITS
from vrcaps.recording.pictures import legend, limits_of, picture
from vrcaps.render.channels import CHANNELS
from vrcaps.tools.report import data_url, html_image, html_note, html_page, html_table
from vrcaps.tools.reports.dataset_sample import (
    SPLIT_COLORS,
    Sample,
    SampledFrame,
    histogram_picture,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

_TILES, _TILE = 48, 190
_EXAMPLES = 4
"""Number of organs of which a frame is shown with all its channels."""
_PROPERTIES = ("organ", "capsule", "posture", "motion")

_OWN_STYLE = """
.facts { display: flex; flex-wrap: wrap; gap: .8em; margin: 1.2em 0; }
.facts div { background: #f4f5f7; border-radius: 6px; padding: .5em 1em; }
.facts b { display: block; font-size: 1.35em; }
.facts span { color: #555; font-size: 13px; }
.columns { display: grid; gap: 0 3em; grid-template-columns: repeat(auto-fit, minmax(460px, 1fr)); }
.columns { margin-bottom: 1em; } .columns h2 { margin-top: 1em; }
.bar { display: flex; width: 220px; height: 12px; background: #f0f0f0; }
td.text { text-align: left; }
.tiles { display: grid; gap: 8px; grid-template-columns: repeat(auto-fill, minmax(140px, 1fr)); }
figure { margin: 0; } figure img { display: block; width: 100%; }
figcaption { color: #555; font-size: 11px; line-height: 1.3; overflow-wrap: anywhere; }
.dot { border-radius: 50%; display: inline-block; height: 9px; width: 9px; margin-right: .3em; }
.warning { background: #fff4de; border-left: 4px solid #e0982f; padding: .5em 1em; }
"""


def write_page(
    path: Path, settings: DatasetSettings, rows: Sequence[Row], sample: Sample, planned: int
) -> None:
    """Write the page atomically; the same data set gives the same bytes.

    Args:
        path: File to write or replace.
        settings: Settings of the data set.
        rows: Its recordings.
        sample: Sample of its frames.
        planned: Number of recordings in its plan.
    """
    parts = [
        f"<h1>{html.escape(settings.name)}</h1>",
        f"<p>{html.escape(settings.description)}</p>" if settings.description else "",
        _facts(count(rows)),
        *_warnings(rows, planned),
        _split_legend(),
        f"<div class='columns'>{_splits(rows)}{''.join(_bars(rows))}</div>",
        f"<div class='columns'>{_segments(rows)}{_lesions(rows, sample)}</div>",
        "<h2>Depth, brightness and speed</h2>",
        html_image("histograms", histogram_picture(sample)),
        html_note(_histogram_note(sample)),
        *_examples(sample),
        *_mosaic(sample),
    ]
    write_bytes(path, html_page(settings.name, parts, _OWN_STYLE))


def _facts(total: Count) -> str:
    facts = {
        "patients": f"{total.patients:,}",
        "recordings": f"{total.recordings:,}",
        "frames": f"{total.frames:,}",
        "images": f"{total.images:,}",
        "recorded": duration_text(total.seconds),
        "on disk": size_text(total.num_bytes),
    }
    cells = (f"<div><b>{value}</b><span>{name}</span></div>" for name, value in facts.items())
    return f"<div class='facts'>{''.join(cells)}</div>"


def _warnings(rows: Sequence[Row], planned: int) -> list[str]:
    warnings = []
    if len(rows) < planned:
        warnings.append(
            f"{len(rows):,} of {planned:,} recordings are complete; the others are missing."
        )
    shared = shared_organs(rows)
    if shared:
        warnings.append(
            f"Patients in different splits have the same organ ({len(shared)} organs): the splits "
            "do not measure generalization to unseen anatomy."
        )
    return [f"<p class='warning'>{text}</p>" for text in warnings]


def _split_legend() -> str:
    dots = (f"{_dot(name)}{name} &nbsp; " for name in SPLITS)
    return html_note(f"{''.join(dots)} — bars: frames.")


def _dot(split: str) -> str:
    return f"<span class='dot' style='background:{SPLIT_COLORS[split]}'></span>"


def _splits(rows: Sequence[Row]) -> str:
    totals = by_split(rows)
    table = [
        {
            "split": name,
            "patients": f"{c.patients:,}",
            "recordings": f"{c.recordings:,}",
            "frames": f"{c.frames:,}",
            "recorded": duration_text(c.seconds),
            "size": size_text(c.num_bytes),
        }
        for name, c in totals.items()
    ]
    return f"<div><h2>Splits</h2>{html_table(table)}</div>"


def _bars(rows: Sequence[Row]) -> list[str]:
    """One table per property of recordings."""
    parts = []
    for key in _PROPERTIES:
        groups = count_by(rows, lambda row, key=key: row.about[key])
        lines = []
        for name, total in groups.items():
            own = [row for row in rows if row.about[key] == name]
            frames = {split: c.frames for split, c in by_split(own).items()}
            lines.append((name, (total.patients, total.recordings, total.frames), frames))
        parts.append(_bar_table(key.capitalize(), ("patients", "recordings", "frames"), lines))
    return parts


def _bar_table(
    title: str,
    numbers: tuple[str, ...],
    lines: Sequence[tuple[Any, tuple[int, ...], Mapping[str, int]]],
) -> str:
    """Table of counts with a stacked bar per line, one part per split."""
    longest = max((sum(frames.values()) for _, _, frames in lines), default=0) or 1
    head = "".join(f"<th>{name}</th>" for name in ("", *numbers, ""))
    body = ""
    for name, counts, frames in lines:
        cells = "".join(f"<td>{number:,}</td>" for number in counts)
        parts = "".join(
            f"<i style='background:{SPLIT_COLORS[split]};width:{100.0 * n / longest:.2f}%'></i>"
            for split, n in frames.items()
        )
        bar = f"<td class='text'><div class='bar'>{parts}</div></td>"
        body += f"<tr><td>{html.escape(str(name))}</td>{cells}{bar}</tr>"
    table = f"<div class='wide'><table><tr>{head}</tr>{body}</table></div>"
    return f"<div><h2>{title}</h2>{table}</div>"


def _segments(rows: Sequence[Row]) -> str:
    lines = [
        (name, (sum(splits.values()),), splits) for name, splits in segment_counts(rows).items()
    ]
    return _bar_table("Frames with the capsule in", ("frames",), lines)


def _lesions(rows: Sequence[Row], sample: Sample) -> str:
    totals = lesion_counts(rows)
    if not totals:
        return "<div><h2>Lesions</h2><p>No recording contains a lesion.</p></div>"
    has_masks = any(shot.has_masks for shot in sample.frames)
    table = []
    for kind, (lesions, patients, recordings) in totals.items():
        seen = sum(kind in shot.lesions for shot in sample.frames)
        row = {
            "kind": kind,
            "lesions": f"{lesions:,}",
            "patients": f"{patients:,}",
            "recordings": f"{recordings:,}",
        }
        share = f"{100.0 * seen / len(sample.frames):.1f} %"
        table.append(row | ({"images with the lesion": share} if has_masks else {}))
    note = f"Images: of {len(sample.frames)} sampled ones. " if has_masks else ""
    note += "A lesion of a patient counts once."
    return f"<div><h2>Lesions</h2>{html_table(table)}{html_note(note)}</div>"


def _histogram_note(sample: Sample) -> str:
    text = f"{len(sample.frames)} images and {len(sample.speeds)} recordings, sampled evenly."
    bright = [shot.brightness for shot in sample.frames if shot.brightness.size]
    if bright:
        pixels = np.concatenate(bright)
        text += (
            f" Of the pixels that the lens illuminates {100 * np.mean(pixels >= 254):.1f} % are "
            f"white and {100 * np.mean(pixels <= 5):.1f} % nearly black (gray level 5 or less)."
        )
    return text + " The last bin contains all larger values."


def _examples(sample: Sample) -> list[str]:
    """One frame of each organ with all its channels."""
    by_organ: dict[str, list[SampledFrame]] = {}
    for shot in sample.frames:
        by_organ.setdefault(shot.organ, []).append(shot)
    parts = ["<h2>Channels</h2>"]
    for frames in list(by_organ.values())[:_EXAMPLES]:
        # A frame with lesions, if there is one, shows the most.
        shot = max(frames, key=lambda shot: len(shot.lesions))
        episode = shot.member.read()
        parts.append(f"{html_note(_caption(shot))}<div class='tiles'>")
        for channel in episode.channels:
            values = episode.image(shot.camera, channel, shot.frame)
            limits = limits_of(channel, [values])
            caption = channel + legend(channel, [values], limits, episode.label_names)
            image = picture(channel, values, limits)
            parts.append(_tile(image, html.escape(caption), CHANNELS[channel].is_categorical))
        parts.append("</div>")
    return parts


def _mosaic(sample: Sample) -> list[str]:
    frames = [shot for shot in sample.frames if shot.brightness.size]
    if not frames:
        return []
    indices = np.unique(
        np.linspace(0, len(frames) - 1, min(_TILES, len(frames))).round().astype(int)
    )
    tiles = read_at_once(_frame_tile, [frames[number] for number in indices])
    return ["<h2>Frames</h2><div class='tiles'>", *tiles, "</div>"]


def _frame_tile(shot: SampledFrame) -> str:
    rgb = shot.member.read().image(shot.camera, "rgb", shot.frame)
    return _tile(rgb, _caption(shot), is_categorical=False)


def _caption(shot: SampledFrame) -> str:
    lesions = f", {', '.join(shot.lesions)}" if shot.lesions else ""
    where = shot.segment if shot.segment == shot.organ else f"{shot.organ}: {shot.segment}"
    text = f"{where}{lesions}; {shot.member.name}, {shot.capsule} {shot.camera}, frame {shot.frame}"
    return f"{_dot(shot.member.split)}{html.escape(text)}"


def _tile(pixels: NDArray, caption: str, is_categorical: bool) -> str:
    """Thumbnail: JPEG, or PNG for categorical images."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(pixels))
    method = Image.Resampling.NEAREST if is_categorical else Image.Resampling.BOX
    scale = _TILE / max(image.size)
    size = (max(round(image.width * scale), 1), max(round(image.height * scale), 1))
    data = io.BytesIO()
    if is_categorical:
        image.resize(size, method).save(data, "PNG")
    else:
        image.resize(size, method).save(data, "JPEG", quality=88)
    source = data_url(data.getvalue(), "image/png" if is_categorical else "image/jpeg")
    return f"<figure><img alt='' src='{source}'><figcaption>{caption}</figcaption></figure>"
