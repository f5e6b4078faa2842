"""Known limits of a data set, for its card: of the simulator, and of its plan."""

from __future__ import annotations

from collections.abc import Sequence

from vrcaps.data.counts import Row

_ALWAYS = (
    "Appearance is a model: colors, vessels, mucus and relief of the mucosa are fitted to frames "
    "of a few real colons and drawn from noise. Images resemble those of real capsules, no more. "
    "Judge a method on real images before you believe its figures.",
    "Generated anatomy follows published lengths and diameters of adults. Diseased, operated, "
    "pediatric or unusual anatomy is not in it, unless organs of your own were given.",
    "Colors of lesions are fitted by eye, lesions stand apart from each other, and a kind has the "
    "variation that its parameters have. Prevalence is that of the plan, not of any hospital.",
    "Labels are exact for the geometry that was rendered: at centers of pixels, without blur or "
    "mixed pixels at edges. People who label real images are not that exact.",
    "This is no medical device. Nothing in it was judged for diagnosis.",
)
_MOTIONS = {
    "fly-through": "The capsule flies along a smooth path in the middle of the lumen: there is no "
    "contact, sliding or tumbling, and the wall makes way where it is narrow.",
    "random-views": "Frames are views of their own, drawn at random, most of them of lesions: "
    "neighbors are no video, and what is shown how often is not what a capsule passes.",
    "replay": "The capsule follows poses that were given; they are as real as their source.",
    "dynamics": "Contact, drag and motility follow published laws with parameters from the "
    "literature. They differ between people and were fitted to no patient.",
}
_LIGHTS = {
    "direct": "Light is reflected once: images have no indirect illumination, so deep lumen and "
    "folds are darker than in real ones.",
    "radiosity": "Indirect light is diffuse and interpolated between points of the wall.",
    "path": "Light is path traced: images carry the noise of their samples.",
}

_TIMES = {"auto_exposure", "adaptive_frame_rate"}
"""Effects that set when and how long a camera exposes, and do not degrade the image."""


def limits_text(rows: Sequence[Row]) -> str:
    """Section of a card on known limits.

    Args:
        rows: Recordings of the data set.
    """
    found = [*_ALWAYS]
    found += [_MOTIONS[m] for m in _MOTIONS if any(row.about["motion"] == m for row in rows)]
    found += [_LIGHTS[k] for k in _LIGHTS if any(row.about["light"] == k for row in rows)]
    clean = sum(not set(row.about["effects"]) - _TIMES for row in rows)
    if clean:
        found.append(
            f"{clean:,} of {len(rows):,} recordings have no effects of lens and sensor: no noise, "
            "blur, bubbles or compression, which real images have."
        )
    without = sum(not row.about["contents"] for row in rows)
    if without:
        found.append(f"{without:,} of {len(rows):,} recordings show an empty, clean lumen.")
    return "## Known limits\n\n" + "".join(f"- {line}\n" for line in found)
