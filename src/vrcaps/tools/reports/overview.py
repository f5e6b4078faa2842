"""Overview of an organ: outside, inside, unrolled, and width over arc length."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps._core import Wall
from vrcaps.core.errors import import_extra
from vrcaps.core.geometry import wall_of
from vrcaps.core.units import CM, MM
from vrcaps.organ.measure import OrganMeasures, arc_length_bins, measure_organ, segment_spans
from vrcaps.organ.surface import OrganSurface
from vrcaps.organ.unroll import dissection_rows
from vrcaps.tools.report import make_figure
from vrcaps.tools.reports.views import VIEWS, inside_views, outside_view, project

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

_WIDTH = 14.0  # width of the image [inch]
_STRIP = 12.6  # width of a row of unrolled wall [inch]
_ROW_HEIGHT = (1.0, 3.4)  # min and max height of such a row [inch]
_MAX_ROWS = 8
_DPI = 110
_INK, _PALE = "#222222", "#777777"
_NUM_VIEWS = 6  # number of inside views if there are fewer segments
_VIEWS_PER_ROW = 9


@dataclass(frozen=True)
class Marked:
    """Lesion as marked in the figure.

    Attributes:
        instance: ID of the instance.
        text: Kind, grade and size.
        center: Point on the wall [m].
        arc_length: Arc length of that point [m].
        theta: Angle of that point [rad].
    """

    instance: int
    text: str
    center: Float[np.ndarray, " 3"]
    arc_length: float
    theta: float


@dataclass(frozen=True)
class _Picture:
    """Data shared by all panels."""

    organ: OrganSurface
    facts: OrganMeasures
    wall: Wall
    lesions: list[Marked]

    @cached_property
    def spans(self) -> list[tuple[int, float, float]]:
        return segment_spans(self.organ)

    @cached_property
    def labels(self) -> list[int]:
        """Labels of the wall, in oral-to-anal order."""
        own = np.unique(self.organ.label)
        return sorted(own.tolist(), key=self.middle)

    @cached_property
    def colors(self) -> Float[np.ndarray, "k 3"]:
        """SRGB color of each label."""
        colors = np.ones((len(self.organ.label_names), 3))
        colors[self.labels] = _palette(len(self.labels))
        return colors

    @cached_property
    def rows(self) -> int:
        """Number of rows of the unrolled wall."""
        return int(np.clip(np.ceil(_ROW_HEIGHT[0] / self._row_height(1)), 1, _MAX_ROWS))

    @property
    def row_height(self) -> float:
        """Height of a row of unrolled wall [inch]; to scale at the median girth if that fits."""
        return float(np.clip(self._row_height(self.rows), *_ROW_HEIGHT))

    @property
    def is_short(self) -> bool:
        """True if the organ is so short that its unrolled wall does not fill a row."""
        return self._row_height(1) > 1.6 * _ROW_HEIGHT[1]

    def _row_height(self, rows: int) -> float:
        girth = 2.0 * np.pi * float(np.median(self.organ.radius))
        return _STRIP * girth * rows / self.organ.centerline.length

    def middle(self, label: int) -> float:
        """Arc length [m] of the middle of a segment."""
        return float(np.median(self.organ.arc_length[self.organ.label == label]))

    def width(self, label: int) -> float:
        """Twice the median distance of a segment's wall to the centerline [m]."""
        return 2.0 * float(np.median(self.organ.radius[self.organ.label == label]))

    def length(self, label: int) -> float:
        """Length of the centerline in a segment [m]."""
        return sum(end - start for other, start, end in self.spans if other == label)

    def name(self, label: int) -> str:
        return self.organ.label_names[label].replace("_", " ")


def write_overview(organ: OrganSurface, path: Path, *, facts: OrganMeasures | None = None) -> None:
    """Write an overview image of an organ.

    Two outside views colored by segment, a table of segments and lesions, an inside view of each
    segment, the unrolled wall, and the width over arc length. Lesions have the same numbers in
    all panels.

    Args:
        organ: The organ, in the patient frame.
        path: Image file to write; its suffix is the format.
        facts: Measures of the organ, if already computed.
    """
    wall = wall_of(organ.vertices, organ.faces)
    picture = _Picture(organ, facts or measure_organ(organ), wall, marked_lesions(organ))
    positions = _view_positions(picture)
    rows_inside = -(-len(positions) // _VIEWS_PER_ROW)
    per_row = -(-len(positions) // rows_inside)
    inside = rows_inside * (min(_STRIP / per_row, 2.2) + 0.3)
    unrolled = picture.rows * (picture.row_height + 0.5) + 0.35
    heights = [0.75, 5.0, inside, unrolled] + ([] if picture.is_short else [2.1])
    fig = make_figure(_WIDTH, sum(heights), layout=None, facecolor="white")
    parts = list(np.ravel(fig.subfigures(len(heights), 1, height_ratios=heights)))  # type: ignore[arg-type]
    _draw_title(parts[0], picture)
    _draw_outside(parts[1], picture)
    _draw_inside(parts[2], picture, positions, per_row)
    if picture.is_short:
        left, right = np.ravel(parts[3].subfigures(1, 2))
        _draw_unrolled(left, picture)
        _draw_width(right, picture)
    else:
        _draw_unrolled(parts[3], picture)
        _draw_width(parts[4], picture)
    fig.savefig(path, dpi=_DPI)


def marked_lesions(organ: OrganSurface) -> list[Marked]:
    """Lesions of an organ: those listed in its metadata, and other instances of its vertices."""
    records = {r.get("instance"): r for r in organ.metadata.get("lesions", [])}
    marked = []
    for number in np.unique(organ.instance[organ.instance > 0]).tolist():
        own = np.flatnonzero(organ.instance == number)
        middle = organ.vertices[own].mean(axis=0)
        vertex = own[np.argmin(np.linalg.norm(organ.vertices[own] - middle, axis=1))]
        record: dict[str, Any] = records.get(number, {})
        size = record.get("specification", {}).get("size")
        words = [record.get("kind", "lesion"), record.get("grade", "")]
        words += [f"{size / MM:.0f} mm"] if size else []
        marked.append(
            Marked(
                instance=number,
                text=" ".join(word for word in words if word),
                center=np.array(record.get("center_m", organ.vertices[vertex])),
                arc_length=float(record.get("arc_length_m", organ.arc_length[vertex])),
                theta=float(record.get("theta_rad", organ.theta[vertex])),
            )
        )
    return marked


def _palette(count: int) -> Float[np.ndarray, "k 3"]:
    """Colors along a rainbow of uniform chroma, distinct from their neighbors."""
    hsv_to_rgb = import_extra("matplotlib.colors", "reports", package="matplotlib").hsv_to_rgb

    hue = (0.60 - 0.92 * np.arange(count) / max(count, 5)) % 1.0
    odd = np.arange(count) % 2
    return hsv_to_rgb(np.stack([hue, 0.50 + 0.16 * odd, 0.93 - 0.13 * odd], axis=1))


def _draw_title(part: SubFigure, picture: _Picture) -> None:
    facts = picture.facts
    num = len(picture.lesions)
    words = [
        f"{facts.length / CM:.1f} cm long",
        f"lumen {facts.volume / CM**3:.0f} ml",
        f"inscribed ball {facts.diameter_min / MM:.0f} mm at the narrowest point, "
        f"{facts.diameter_median / MM:.0f} mm in the median",
        f"wall {facts.area / CM**2:.0f} cm²",
        f"{facts.num_faces:,} triangles",
        f"{num} lesion{'s' * (num != 1)}" if num else "no lesions",
    ]
    part.text(0.03, 0.55, facts.name, size=22, weight="bold", color=_INK, va="center")
    part.text(0.03, 0.12, "   ·   ".join(words), size=11, color=_PALE, va="center")


def _draw_outside(part: SubFigure, picture: _Picture) -> None:
    """Draw two views, and the table of segments and lesions."""
    organ = picture.organ
    low, high = organ.vertices.min(axis=0), organ.vertices.max(axis=0)
    center = (low + high) / 2.0
    half = 1.03 * (high - low).max() / 2.0
    grid = part.add_gridspec(1, 3, width_ratios=(1, 1, 0.8), left=0.03, right=0.98, wspace=0.03)
    colors = picture.colors
    for column, (title, axes) in enumerate(VIEWS.items()):
        view = part.add_subplot(grid[0, column])
        image = outside_view(organ, picture.wall, axes, center, half, colors=colors)
        view.imshow(image, extent=tuple(half / CM * np.array([-1, 1, -1, 1])))
        view.set_title(title, size=11, color=_INK, loc="left")
        view.set_axis_off()
        for lesion in picture.lesions:
            x, y = project(lesion.center, axes, center) / CM
            _draw_number(view, x, y, lesion.instance)
        _draw_scale(view, half / CM)
    _draw_table(part.add_subplot(grid[0, 2]), picture)


def _draw_scale(view: Axes, half_cm: float) -> None:
    """Draw a scale bar of a round length in the lower left corner."""
    length = max(x for x in (0.5, 1, 2, 5, 10, 20) if x <= max(0.5, 0.5 * half_cm))
    x, y = -0.97 * half_cm, -0.97 * half_cm
    view.plot([x, x + length], [y, y], color=_INK, lw=2, solid_capstyle="butt")
    view.text(x, y + 0.03 * half_cm, f"{length:g} cm", size=9, color=_INK)


def _draw_number(view: Axes, x: float, y: float, index: int) -> None:
    box = {"boxstyle": "circle,pad=0.22", "fc": "white", "ec": _INK, "lw": 0.8, "alpha": 0.92}
    view.text(x, y, f"{index}", size=8, ha="center", va="center", color=_INK, bbox=box)


def _draw_table(table: Axes, picture: _Picture) -> None:
    """Draw segments with their colors and widths, then lesions with their numbers."""
    table.set_axis_off()
    table.set(xlim=(0, 1), ylim=(0, 1))
    lines = [(label, None) for label in picture.labels] + [(None, le) for le in picture.lesions]
    listed = lines[:26]
    step = min(1.0 / (len(listed) + 3), 0.055)
    size = 10 if step > 0.04 else 8.5
    y = 1.0 - step
    table.text(0.06, y, "segment", size=size, color=_PALE)
    table.text(0.74, y, "length", size=size, color=_PALE, ha="right")
    table.text(0.98, y, "width", size=size, color=_PALE, ha="right")
    for label, lesion in listed:
        y -= step
        if label is not None:
            table.plot([0.02], [y + 0.3 * step], "s", ms=9, color=picture.colors[label])
            table.text(0.06, y, picture.name(label), size=size, color=_INK)
            span = picture.length(label)
            text = f"{span / CM:.1f} cm" if span else "adjacent"
            table.text(0.74, y, text, size=size, color=_INK, ha="right")
            text = f"{picture.width(label) / MM:.0f} mm"
            table.text(0.98, y, text, size=size, color=_INK, ha="right")
        elif lesion is not None:
            if lesion is picture.lesions[0]:
                y -= 0.8 * step
            _draw_number(table, 0.02, y + 0.3 * step, lesion.instance)
            table.text(0.06, y, lesion.text, size=size, color=_INK)
            text = f"{lesion.arc_length / CM:.1f} cm"
            table.text(0.98, y, text, size=size, color=_INK, ha="right")
    if len(lines) > len(listed):
        table.text(0.06, y - step, f"and {len(lines) - len(listed)} more", size=size, color=_PALE)


def _view_positions(picture: _Picture) -> list[tuple[str, float, Any]]:
    """Title, arc length [m] and color of each inside view: one per segment, more for long ones."""
    organ, labels = picture.organ, picture.labels
    share = {label: max(picture.length(label), 1e-9) for label in labels}
    count = dict.fromkeys(labels, 1)
    while sum(count.values()) < _NUM_VIEWS:
        count[max(labels, key=lambda label: share[label] / count[label])] += 1
    positions = []
    for label in labels:
        own = organ.arc_length[organ.label == label]
        for part in range(count[label]):
            at = float(np.quantile(own, (part + 0.5) / count[label]))
            where = f", {at / CM:.0f} cm" if count[label] > 1 else ""
            positions.append((picture.name(label) + where, at, picture.colors[label]))
    return positions


def _draw_inside(
    part: SubFigure, picture: _Picture, positions: list[tuple[str, float, Any]], per_row: int
) -> None:
    rows = -(-len(positions) // per_row)
    grid = part.add_gridspec(
        rows, per_row, left=0.03, right=0.98, top=0.90, bottom=0.02, wspace=0.05, hspace=0.3
    )
    images = inside_views(picture.organ, [at for _, at, _ in positions])
    for number, ((title, _, color), image) in enumerate(zip(positions, images, strict=True)):
        view = part.add_subplot(grid[divmod(number, per_row)])
        view.imshow(image)
        view.set(xticks=[], yticks=[])
        view.spines[:].set_visible(False)
        view.spines["bottom"].set(visible=True, color=color, linewidth=4)
        view.set_title(title, size=9 if per_row > 6 else 10, color=_INK)


def _draw_unrolled(part: SubFigure, picture: _Picture) -> None:
    """Draw the unrolled wall in as many rows as needed."""
    length = picture.organ.centerline.length
    high = picture.rows * (picture.row_height + 0.5) + 0.35
    left, right = (0.10, 0.97) if picture.is_short else (0.05, 0.98)
    grid = part.add_gridspec(
        *(picture.rows, 1),
        **{"left": left, "right": right, "top": 1 - 0.35 / high, "bottom": 0.42 / high},
        hspace=0.5 / picture.row_height,
    )
    title = "Wall unrolled: distance from the oral end [cm] across, angle around the centerline up"
    part.text(left, 1.0 - 0.08 / high, title, size=10, color=_INK, va="top")
    span = length / picture.rows
    wide = int(_STRIP * _DPI) // (2 if picture.is_short else 1)
    size = (int(picture.row_height * _DPI), wide)
    rows = dissection_rows(picture.organ, picture.wall, picture.rows, size)
    for row, (image, instance) in enumerate(rows):
        view = part.add_subplot(grid[row, 0])
        box = (span * row / CM, span * (row + 1) / CM, -180.0, 180.0)
        view.imshow(image, extent=box, aspect="auto", interpolation="none")
        _draw_lesions(view, picture, instance, box)
        _draw_bar(view, picture, 194.0, 214.0)
        view.set(xlim=box[:2], ylim=(-180, 214), yticks=[-180, -90, 0, 90, 180])
        view.set_yticklabels([f"{angle}°" for angle in (-180, -90, 0, 90, 180)])
        _tidy(view)


def _draw_lesions(
    view: Axes, picture: _Picture, instance: np.ndarray, box: tuple[float, float, float, float]
) -> None:
    """Draw outlines and numbers of the lesions in a row."""
    for lesion in picture.lesions:
        mask = instance == lesion.instance
        if mask.any():
            view.contour(
                mask, [0.5], colors="white", linewidths=1.0, extent=box, origin="upper", alpha=0.9
            )
            across, up = np.flip(np.median(np.argwhere(mask), axis=0) / mask.shape)
            at, angle = box[0] + (box[1] - box[0]) * across, 180.0 - 360.0 * up
        else:
            at, angle = lesion.arc_length / CM, np.degrees(lesion.theta)
        if box[0] <= at <= box[1]:
            aside = 34.0 if angle < 120.0 else -34.0
            _draw_number(view, at, angle + aside, lesion.instance)


def _draw_bar(view: Axes, picture: _Picture, low: float, high: float) -> None:
    """Draw a strip of the segments' colors, between two heights of the axes."""
    for label, start, end in picture.spans:
        view.fill_between(
            [start / CM, end / CM], low, high, color=picture.colors[label], lw=0, zorder=3
        )


def _tidy(view: Axes) -> None:
    view.tick_params(labelsize=8, colors=_PALE, length=2, width=0.6)
    view.spines[:].set_visible(False)


def _draw_width(part: SubFigure, picture: _Picture) -> None:
    """Draw width over arc length: median over the angle, band from 10 % to 90 %."""
    organ = picture.organ
    left, right = (0.10, 0.96) if picture.is_short else (0.05, 0.98)
    graph = part.add_axes((left, 0.24, right - left, 0.58))
    bins = arc_length_bins(organ)
    edges = np.linspace(0.0, organ.centerline.length, bins + 1)
    which = np.clip(np.digitize(organ.arc_length, edges) - 1, 0, bins - 1)
    order = np.argsort(which, kind="stable")
    groups = np.split(organ.radius[order], np.searchsorted(which[order], np.arange(1, bins)))
    middle = (edges[1:] + edges[:-1]) / 2.0 / CM
    filled = [i for i, group in enumerate(groups) if len(group)]
    low, median, high = (
        2.0 / MM * np.array([np.quantile(groups[i], share) for i in filled])
        for share in (0.1, 0.5, 0.9)
    )
    graph.fill_between(middle[filled], low, high, color="#e3e3e3", lw=0)
    graph.plot(middle[filled], median, color=_INK, lw=1.2)
    top = 1.12 * float(high.max())
    _draw_bar(graph, picture, 1.0 * top, 1.06 * top)
    graph.set(xlim=(0, edges[-1] / CM), ylim=(0, 1.06 * top))
    title = "Width (2 × distance of the wall) [mm] along the centerline [cm], 10 to 90 %"
    graph.set_title(title, size=10, color=_INK, loc="left")
    graph.grid(axis="y", color="#eeeeee", lw=0.8)
    _tidy(graph)
