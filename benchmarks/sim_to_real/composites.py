"""Claim: rendered lesions in real images without lesions are training data for real lesions.

Evaluates published weights on the validation images of WCEBleedGen next to trivial baselines, and
trains classifiers of bleeding on few real images, with composites and without.

    python -m benchmarks.sim_to_real.composites --real /data/wce_bleedgen --normals runs/normals
    vrcaps dataset composite runs/pairs --into runs/normals/training --out runs/composites
    python -m benchmarks.sim_to_real.composites --real /data/wce_bleedgen \
        --composites runs/composites --weights segmentation segmentation-multiclass

The first command copies the training images without bleeding that share no group of near copies and
consecutive frames with a validation image: a fifth of their groups for the selection of weights.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from scipy.special import expit

from benchmarks.common.scripts import ROOT, table
from benchmarks.sim_to_real.images import alike, disc_only
from benchmarks.sim_to_real.page import PAGE, write_part
from vrcaps.core import rng
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.learn.baselines import mask_baselines, redness
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.networks import ENCODER, classifier
from vrcaps.learn.picture_border import Letterbox
from vrcaps.learn.samples import batch_of
from vrcaps.metrics.bootstrap import bootstrap, resampled_items
from vrcaps.metrics.labels import confusion_matrix, dice, f1_scores, roc_auc

MODULE = "benchmarks.sim_to_real.composites"
COUNTS = (4, 8, 16, 32, 64)
"""Numbers of real images with bleeding, each of another group."""
SEEDS, SIZE, COMPONENTS = 20, 112, 128
"""Draws of real images, side of the classifier's images [px], and its principal components."""
RESAMPLES = 1000
WEIGHT = 300.0
"""Weight of each class relative to the squared norm of the coefficients."""


@dataclass(frozen=True)
class RealImages:
    """Images of WCEBleedGen.

    Attributes:
        paths: Files.
        images: Colors [h w 3].
        masks: Masks of bleeding [h w], empty for the others.
        bleeds: Whether each shows bleeding [n].
        held: Whether each is of the validation part [n].
        groups: Group of near copies and consecutive frames of each [n].
    """

    paths: Sequence[Path]
    images: Sequence[np.ndarray]
    masks: Sequence[np.ndarray]
    bleeds: np.ndarray
    held: np.ndarray
    groups: np.ndarray

    @property
    def apart(self) -> np.ndarray:
        """Whether each is a training image in no group with a validation image [n]."""
        return ~self.held & ~np.isin(self.groups, self.groups[self.held])


def main() -> None:
    """Copy training images, or evaluate and write the section."""
    made = argparse.ArgumentParser(
        prog=f"python -m {MODULE}",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("--real", type=Path, required=True, help="folder of WCEBleedGen")
    made.add_argument("--normals", type=Path, help="folder to create with images for composites")
    made.add_argument("--composites", type=Path, help="output of `vrcaps dataset composite`")
    made.add_argument("--weights", nargs="*", default=(), help="published names, or files")
    made.add_argument("--out", type=Path, default=PAGE, help="Markdown page to write into")
    given = made.parse_args()
    try:
        torch.set_num_threads(1)
        real = read_real(given.real)
        if given.normals is not None:
            print(copied(real, given.normals))
            return
        if given.composites is None:
            raise InputError("Give --normals to copy images, or --composites to evaluate.")
        parts = [segmentation_part(real, given.weights), classes_part(real, given.composites)]
    except VrcapsError as error:
        sys.exit(str(error))
    files = " ".join(f"runs/{Path(one).name}" if "/" in one else one for one in given.weights)
    command = f"python -m {MODULE} --real … --composites runs/composites --weights {files}"
    write_part(
        given.out, MODULE, "\n\n".join(["## Lesions in real images: results", *parts]), command
    )


def read_real(folder: Path) -> RealImages:
    """Read the images of a folder with `train` and `val`, each with masks and two classes.

    Raises:
        InputError: If it has none.
    """
    paths = [
        path
        for part in ("train", "val")
        for kind in ("bleeding", "non_bleeding")
        for path in sorted((folder / part / kind).glob("*.*"))
    ]
    if not paths:
        raise InputError(f"{folder} contains no train/bleeding and so on of WCEBleedGen.")
    images = [np.asarray(Image.open(path).convert("RGB")) for path in paths]
    bleeds = np.array([path.parent.name == "bleeding" for path in paths])
    numbers = np.array([int(path.stem) for path in paths])
    order = numbers + 2 * numbers.max() * ~bleeds
    masks = [_mask(path, image) for path, image in zip(paths, images, strict=True)]
    held = np.array([path.parents[1].name == "val" for path in paths])
    return RealImages(paths, images, masks, bleeds, held, alike(images, order.tolist()))


def _mask(path: Path, image: np.ndarray) -> np.ndarray:
    file = path.parents[1] / f"{path.parent.name}_mask" / f"{path.stem}.png"
    if not file.exists():
        return np.zeros(image.shape[:2], bool)
    return np.asarray(Image.open(file).convert("L")) > 127


def copied(real: RealImages, folder: Path) -> dict[str, int]:
    """Copy training images without bleeding into `training` and `held-out`, by whole groups."""
    chosen = np.flatnonzero(real.apart & ~real.bleeds).tolist()
    groups = rng.stream(0, "benchmarks/normals").permutation(np.unique(real.groups[chosen]))
    held = set(groups[: len(groups) // 5].tolist())
    counts = {"training": 0, "held-out": 0}
    for part in counts:
        (folder / part).mkdir(parents=True)
    for index in chosen:
        part = "held-out" if real.groups[index] in held else "training"
        shutil.copyfile(real.paths[index], folder / part / real.paths[index].name)
        counts[part] += 1
    return counts


def segmentation_part(real: RealImages, weights: Sequence[str]) -> str:
    """Table of the Dice coefficient on bleeding, and of normal images with a mask."""
    held = np.flatnonzero(real.held).tolist()
    train = np.flatnonzero(~real.held & real.bleeds).tolist()
    images = [real.images[k] for k in held]
    estimates: dict[str, Sequence[np.ndarray]] = {}
    for name in weights:
        path = Path(name) if name.endswith(".safetensors") else ROOT / f"weights/{name}.safetensors"
        estimates[f"`{Path(name).stem}`"] = predicted(read_weights(path), images)
    estimates |= mask_baselines(images, [real.masks[k] for k in held])
    level = _train_level(real, train)
    estimates["redness, threshold of training images"] = [redness(one) >= level for one in images]
    del estimates["nothing"]
    bleeds, groups = real.bleeds[held], real.groups[held]
    scores = {
        name: np.array([dice(m, real.masks[k]) for m, k in zip(masks, held, strict=True)])
        for name, masks in estimates.items()
    }
    marked = {name: np.array([m.any() for m in masks]) for name, masks in estimates.items()}
    apart = bleeds & ~np.isin(groups, real.groups[train])
    rows = [
        [
            name,
            _mean(scores[name], bleeds, groups),
            _mean(scores[name] - scores["redness"], bleeds, groups),
            _mean(scores[name] - scores["redness"], apart, groups),
            _mean(marked[name], bleeds, groups),
            _mean(marked[name], ~bleeds, groups),
        ]
        for name in estimates
    ]
    head = ["", "Dice", "Dice − redness", "the same, apart", "bleeding marked", "normal marked"]
    text = (
        f"{bleeds.sum()} validation images with bleeding and {(~bleeds).sum()} without, of "
        f"{len(np.unique(groups))} groups; 95 % intervals over groups. Disc and redness are fitted "
        "to these images; the last row is fitted to the training images with their masks, of which "
        "consecutive frames are among the validation images. *Apart* are the "
        f"{apart.sum()} images of groups without such a training image. *Marked* is the fraction "
        "of images with any pixel in the mask. No network has seen a real lesion."
    )
    return f"### Segmentation of bleeding\n\n{table(head, rows)}\n\n{text}"


def _train_level(real: RealImages, train: Sequence[int]) -> float:
    """Threshold of redness with the highest mean Dice coefficient on training images."""
    red = [redness(real.images[k]) for k in train]
    levels = np.quantile(np.stack([one[::4, ::4] for one in red]), np.linspace(0.02, 0.98, 25))
    means = [
        np.mean([dice(one >= level, real.masks[k]) for one, k in zip(red, train, strict=True)])
        for level in levels
    ]
    return float(levels[int(np.argmax(means))])


def _mean(values: np.ndarray, chosen: np.ndarray, groups: np.ndarray) -> str:
    """Mean over chosen images with its interval."""
    kept, names = values[chosen].astype(float), groups[chosen]
    interval = bootstrap(lambda k: kept[k].mean(), len(kept), groups=names, resamples=RESAMPLES)
    return str(interval)


def predicted(trained: TrainedNetwork, images: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Masks of bleeding, or of any lesion if the network has no such class."""
    classes = getattr(trained.task, "classes", ())
    index = classes.index("bleeding") if "bleeding" in classes else 0
    masks = []
    for image in images:
        letterbox = Letterbox(*image.shape[:2], trained.task.input_size)
        output = trained(batch_of([trained.task.inputs(image, letterbox, None)]))[0]
        masks.append(letterbox.back(output[index]) > 0.0)
    return masks


def classes_part(real: RealImages, composites: Path) -> str:
    """Table of classifiers of bleeding by number of real images, with composites and without."""
    made = {
        kind: [
            np.asarray(Image.open(path).convert("RGB"))
            for path in sorted((composites / kind).glob("*.jpg"))
        ]
        for kind in ("bleeding", "normal")
    }
    kept = np.flatnonzero(real.held | real.apart).tolist()
    features = features_of([*(real.images[k] for k in kept), *made["bleeding"], *made["normal"]])
    held, bleeds, groups = real.held[kept], real.bleeds[kept], real.groups[kept]
    hidden = np.concatenate([held, np.zeros(len(features) - len(kept), bool)])
    features = components(features, hidden)
    own, rendered = features[: len(kept)], features[len(kept) :]
    is_lesion = np.arange(len(rendered)) < len(made["bleeding"])
    rows = []
    for count in COUNTS:
        logits = [
            _logits(own, (held, bleeds, groups), (rendered, is_lesion), count, seed)
            for seed in range(SEEDS)
        ]
        rows.append([str(count), *_compared(logits, bleeds[held], groups[held])])
    head = ["real images with bleeding", "F1 without composites", "F1 with", "difference, points"]
    text = (
        f"Mean F1 of bleeding and normal on the {held.sum()} validation images, mean over {SEEDS} "
        "draws of the real images with bleeding, each of another group, all of no group with a "
        f"validation image; 95 % intervals over draws and groups. All classifiers have "
        f"{(~held & ~bleeds).sum()} real normal images, each class with half of the weight. A "
        "classifier is a logistic regression of "
        f"{COMPONENTS} principal components of the ImageNet features of EfficientNet-Lite0 (mean "
        f"and maximum, {SIZE} px, the inscribed disc of each image), so this does not show what "
        "a trained encoder gains. Where the AUC does not increase, the gain is that of the "
        "decision threshold, which few images determine badly."
    )
    made_text = (
        f"{len(made['bleeding'])} composites with bleeding and {len(made['normal'])} without."
    )
    shown = table([*head, "AUC"], rows)
    return f"### Classification with few real images\n\n{shown}\n\n{text} {made_text}"


def features_of(images: Sequence[np.ndarray]) -> np.ndarray:
    """ImageNet features of the inscribed disc of each image [n k]."""
    network: Any = classifier(ENCODER, 2, is_pretrained=True, dropout=0.0).eval()
    found = []
    with torch.no_grad():
        for start in range(0, len(images), 16):
            part = [
                Letterbox(*one.shape[:2], SIZE).image(disc_only(one))
                for one in images[start : start + 16]
            ]
            batch = batch_of([{"image": one} for one in part])["image"]
            maps = network.forward_features(2.0 * batch - 1.0)
            found.append(torch.cat([maps.mean((2, 3)), maps.amax((2, 3))], dim=1).numpy())
    return np.concatenate(found).astype(float)


Parts = tuple[np.ndarray, np.ndarray, np.ndarray]


def _logits(
    own: np.ndarray, parts: Parts, made: tuple[np.ndarray, np.ndarray], count: int, seed: int
) -> np.ndarray:
    """Logits of the validation images, without composites and with them [2 n]."""
    held, bleeds, groups = parts
    draw = rng.stream(seed, "benchmarks/few", count)
    candidates = np.flatnonzero(~held & bleeds)
    names = draw.permutation(np.unique(groups[candidates]))[:count]
    few = np.array([draw.choice(candidates[groups[candidates] == name]) for name in names])
    normal = np.flatnonzero(~held & ~bleeds)
    chosen = np.concatenate([normal, few])
    sets = [(own[chosen], bleeds[chosen], np.ones(len(chosen)))]
    # Real and composited images of a class have half of its weight each.
    real = np.where(bleeds[chosen], 1.0 / len(few), 1.0 / len(normal))
    share = np.where(made[1], 1.0 / made[1].sum(), 1.0 / (~made[1]).sum())
    sets.append(
        (
            np.concatenate([own[chosen], made[0]]),
            np.concatenate([bleeds[chosen], made[1]]),
            np.concatenate([real, share]),
        )
    )
    return np.stack([_fitted(*one, own[held]) for one in sets])


def _fitted(
    inputs: np.ndarray, truth: np.ndarray, weight: np.ndarray, held: np.ndarray
) -> np.ndarray:
    """Logits of a logistic regression by Newton's method, both classes with equal weight."""
    for value in (False, True):
        weight = np.where(truth == value, weight / weight[truth == value].sum(), weight)
    weight = WEIGHT * weight
    rows = np.column_stack([inputs, np.ones(len(inputs))])
    penalty = np.eye(rows.shape[1])
    penalty[-1, -1] = 1e-6
    values = np.zeros(rows.shape[1])
    for _ in range(25):
        chance = expit(rows @ values)
        curvature = rows.T @ (rows * (weight * chance * (1.0 - chance) + 1e-9)[:, None])
        slope = rows.T @ (weight * (chance - truth)) + penalty @ values
        values = values - np.linalg.solve(curvature + penalty, slope)
    return held @ values[:-1] + values[-1]


def components(features: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Whitened principal components of features [n k], computed without the held ones."""
    known = features[~held]
    scaled = (features - known.mean(axis=0)) / (known.std(axis=0) + 1e-3)
    axes = np.linalg.eigh(scaled[~held].T @ scaled[~held])[1][:, : -COMPONENTS - 1 : -1]
    found = scaled @ axes
    return found / found[~held].std(axis=0)


def _compared(logits: Sequence[np.ndarray], truth: np.ndarray, groups: np.ndarray) -> list[str]:
    """Mean F1 without and with composites, their difference, and AUC, with intervals."""
    guesses = np.stack(logits) > 0.0

    def score(guess: np.ndarray, items: np.ndarray) -> float:
        confusion = confusion_matrix(guess[items].astype(int), truth[items].astype(int), 2)
        return 100.0 * float(f1_scores(confusion).mean())

    draw = rng.stream(0, "benchmarks/few/bootstrap")
    everything = np.arange(len(truth))
    values = np.array([[score(one[k], everything) for k in range(2)] for one in guesses])
    drawn = []
    for items in resampled_items(len(truth), groups, 200, 0):
        seeds = draw.integers(len(guesses), size=len(guesses))
        drawn.append(
            np.mean([[score(guesses[s][k], items) for k in range(2)] for s in seeds], axis=0)
        )
    changes = np.diff(drawn, axis=1)[:, 0]
    low, high = np.quantile(changes, (0.025, 0.975))
    mean = values.mean(axis=0)
    areas = np.mean([[roc_auc(one[k], truth) for k in range(2)] for one in logits], axis=0)
    ends = np.quantile(drawn, (0.025, 0.975), axis=0)
    shown = [f"{mean[k]:.1f} [{ends[0, k]:.1f}, {ends[1, k]:.1f}]" for k in range(2)]
    difference = f"{mean[1] - mean[0]:+.1f} [{low:+.1f}, {high:+.1f}]"
    return [*shown, difference, f"{areas[0]:.3f} → {areas[1]:.3f}"]


if __name__ == "__main__":
    main()
