"""The experiment on real images: its cells, groups, folds and intervals; a small whole run."""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from PIL import Image

from benchmarks.sim_to_real import __main__ as sim_to_real
from benchmarks.sim_to_real import ablate, simulated
from benchmarks.sim_to_real.ablations import COMPLETE, PLAN, VARIANTS, without
from benchmarks.sim_to_real.cells import LONG, ROWS, Cell, Row, RowFile, ordered_cells
from benchmarks.sim_to_real.depth import (
    DepthImage,
    by_light,
    by_network,
    constant,
    depth_values,
    read_sinus,
    without_border,
)
from benchmarks.sim_to_real.images import Pictures, alike, balanced_folds, disc_only, merged
from benchmarks.sim_to_real.initialize import first_folder, first_weights
from benchmarks.sim_to_real.page import ARM_TITLES, PAGE, PAIRS, by_arm, report, verdict
from benchmarks.sim_to_real.real import found_layouts, kvasir_class, read_classes, read_masks
from benchmarks.sim_to_real.setup import Setup
from benchmarks.sim_to_real.simulated import our_classes, our_masks
from benchmarks.sim_to_real.statistics import Judged, difference_interval, figure_interval
from benchmarks.sim_to_real.tasks import OUR_LESIONS, TASKS
from tests.support.real_folders import scene, write_real
from tests.support.small_frames import small_sequence
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.cli.benchmarks.report import read_sections
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.data.plan import read_plan
from vrcaps.learn.checkpoint import read_weights
from vrcaps.learn.settings import IMAGENET
from vrcaps.learn.tasks.segmentation import LESION
from vrcaps.learn.training import WEIGHTS
from vrcaps.metrics.bootstrap import Interval
from vrcaps.metrics.labels import confusion_matrix, f1_scores
from vrcaps.recording.frame_sequence import FrameSequence

ARMS = {"masks": ("scratch", "imagenet", "ours"), "classes": ("scratch", "ours")}
MADE_OF = {"basis": "a", "first": "b"}
SUMMARY = {
    "segmentation of polyps": "polyp-masks",
    "segmentation of bleeding": "bleeding-masks",
    "polyp or colitis": "polyp-classes",
    "bleeding or not": "bleeding-classes",
    "super-resolution": "super-resolution",
}
"""Names of tasks in the summary of the page."""


def mean(sums):
    return sums[:, 0] / sums[:, 1]


def judged(values, groups=None):
    values = np.asarray(values, float)
    groups = np.arange(len(values)) if groups is None else np.asarray(groups)
    return Judged(np.column_stack([values, np.ones_like(values)]), groups)


def test_the_most_telling_cells_come_first():
    cells = ordered_cells(ARMS, (0.1, 1.0), seeds=2)
    assert len(cells) == len(set(cells)) == 2 * (2 * 5 + 2)
    assert [cell.fraction for cell in cells] == [0.1] * 10 + [0.0] * 4 + [1.0] * 10
    assert {cell.arm for cell in cells if cell.fraction == 0.0} == {"ours"}
    # One that was stopped has as many seeds of each arm.
    assert {cell.seed for cell in cells[:5]} == {0}


def test_the_longest_training_is_of_all_real_images():
    cells = ordered_cells({"classes": ("imagenet", LONG)}, (0.1, 1.0), seeds=2)
    assert [cell.seed for cell in cells if cell == Cell("classes", LONG, 1.0, cell.seed)] == [0, 1]
    assert sum(cell.arm == LONG for cell in cells) == 2
    assert LONG in TASKS["polyp-classes"].arms
    assert first_weights(Setup({}, Path()), Cell("polyp-classes", LONG, 1.0, 0)) == IMAGENET


def test_the_summary_of_the_page_is_what_its_sections_say():
    sections = read_sections(PAGE)
    rows = re.findall(r"^\| (.+?), (?:Dice|F1|dB) \|(.*?)\|(.*?)\|$", sections[""], re.M)
    assert {name for name, *_ in rows} == {*SUMMARY}
    for name, *shown in rows:
        section = sections[f"benchmarks.sim_to_real {SUMMARY[name]}"]
        for pair, text in zip(PAIRS, shown, strict=False):
            words = re.escape(" − ".join(ARM_TITLES[arm] for arm in pair))
            found = re.search(rf"^\| 10 % \| {words} \| (.*?) \| (.*?) \|$", section, re.M)
            figure = "" if found is None else found[1]
            is_significant = found is not None and "not significant" not in found[2]
            assert text.strip() == (f"**{figure}**" if is_significant else figure)


def test_rows_survive_a_kill_in_the_middle_of_a_line(tmp_path):
    rows = RowFile(tmp_path)
    cells = [Cell("masks", "ours", 0.1, seed) for seed in range(3)]
    for cell in cells[:2]:
        rows.add(Row(cell, MADE_OF, {"dice": [0.5, 1.0]}, [0, 1], 1.0))
    path = tmp_path / ROWS
    path.write_bytes(path.read_bytes()[:-20])
    again = RowFile(tmp_path)
    assert [again.has(cell, MADE_OF) for cell in cells] == [True, False, False]
    assert not again.has(cells[0], {**MADE_OF, "first": "other images"})
    again.add(Row(cells[2], MADE_OF, {"dice": [0.25]}, [4], 2.0))
    third = RowFile(tmp_path)
    assert [third.has(cell, MADE_OF) for cell in cells] == [True, False, True]
    assert [row.values["dice"] for row in third.rows.values()] == [[0.5, 1.0], [0.25]]


def test_a_damaged_row_is_named(tmp_path):
    (tmp_path / ROWS).write_text(json.dumps({"cell": {}}) + "\n{}\n")
    with pytest.raises(InputError, match=r"Line 1 of .* is damaged"):
        RowFile(tmp_path)


def test_rows_of_other_data_or_settings_are_not_mixed():
    old, new = {"basis": "a", "first": "x"}, {"basis": "a", "first": "y"}
    rows = [Row(Cell("m", "ours", 0.1, seed), old, {}, [], 1.0) for seed in range(3)]
    rows += [Row(Cell("m", "scratch", 0.1, 0), {"basis": "a", "first": ""}, {}, [], 1.0)]
    rows += [Row(Cell("m", "ours", 0.1, 1), new, {}, [], 1.0)]
    found = by_arm(rows)
    assert {*found["m", "ours", 0.1, ""]} == {1}
    assert {*found["m", "scratch", 0.1, ""]} == {0}
    rows += [Row(Cell("m", "scratch", 0.1, 0), {"basis": "b", "first": ""}, {}, [], 1.0)]
    assert {*by_arm(rows)} == {("m", "scratch", 0.1, "")}


def test_near_copies_are_one_group_and_others_are_not():
    images = [scene(seed) for seed in range(12)]
    noise = np.random.default_rng(0).normal(0.0, 3.0, images[0].shape)
    copies = [
        np.clip(images[0].astype(int) + 12, 0, 255).astype(np.uint8),
        np.asarray(Image.fromarray(images[0]).resize((80, 80))),
        np.pad(images[0], ((9, 9), (20, 20), (0, 0))),
        np.clip(images[0] + noise, 0, 255).astype(np.uint8),
    ]
    groups = alike([*images, *copies])
    assert len(set(groups[:12])) == 12
    assert set(groups[12:]) == {groups[0]}


def test_frames_that_follow_each_other_are_one_group():
    def blend(x):
        return (scene(0) * (1.0 - x) + scene(1) * x).astype(np.uint8)

    video = [blend(x) for x in np.linspace(0.1, 0.9, 4)]
    shuffled = np.random.default_rng(0).permutation(5)
    frames = [[*video, scene(5)][k] for k in shuffled]
    apart, joined = alike(frames), alike(frames, shuffled.tolist())
    assert len(set(joined)) == 2 < len(set(apart))
    assert list(joined).count(joined[list(shuffled).index(4)]) == 1
    assert len(set(alike(frames, [None] * 5))) == len(set(apart))


def test_groups_of_one_patient_are_joined():
    groups = merged(np.array([0, 0, 1, 2, 3]), ["a", "b", "b", "c", "c"])
    assert groups[0] == groups[1] == groups[2]
    assert groups[3] == groups[4] != groups[0]


def test_folds_hold_out_whole_groups_and_as_many_of_each_class():
    rng = np.random.default_rng(0)
    groups = rng.integers(0, 120, 400)
    groups = np.unique(groups, return_inverse=True)[1]
    classes = ["polyp" if group % 3 else "colitis" for group in groups]
    folds = balanced_folds(groups, classes)
    assert all(len(set(folds[groups == group])) == 1 for group in set(groups))
    for name in ("polyp", "colitis"):
        counts = np.bincount(folds[np.array(classes) == name], minlength=5)
        assert counts.max() - counts.min() <= 6
    with pytest.raises(InputError, match="fewer than 5 folds"):
        balanced_folds(np.array([0, 1, 1, 2]), ())


def test_a_fold_of_everything_is_no_fold():
    pictures = Pictures("p", [scene(0)] * 2, groups=np.zeros(2, int), folds=np.zeros(2, int))
    with pytest.raises(InputError, match="holds out 2 of 2"):
        pictures.split(0)


def test_what_recorders_print_is_black():
    shown = disc_only(np.full((100, 120, 3), 200, np.uint8), has_overlays=True)
    assert not shown[0].any() and not shown[65:, :55].any() and not shown[:, :18].any()
    assert shown[50, 60].all() and shown[30, 60].all()
    assert disc_only(np.ones((100, 120)), has_overlays=False)[75, 30] == 1


def test_interval_of_a_mean_is_that_of_two_stages():
    """Var = between / S + within / (S n), for normal numbers of S seeds with n images each."""
    rng = np.random.default_rng(1)
    num_seeds, count, between, within = 40, 60, 0.3, 1.0
    centers = 2.0 + between * rng.standard_normal(num_seeds)
    seeds = [judged(c + within * rng.standard_normal(count)) for c in centers]
    interval = figure_interval(mean, seeds)
    spread = np.sqrt(between**2 / num_seeds + 2.0 * within**2 / (num_seeds * count))
    # Seeds' means hold the images' scatter, which is drawn once more: hence 2 within.
    assert (interval.high - interval.low) / (2 * 1.96) == pytest.approx(spread, rel=0.25)
    assert interval.value == pytest.approx(np.mean([s.features[:, 0].mean() for s in seeds]))
    assert interval.low < 2.0 < interval.high


def test_images_of_one_group_count_as_one():
    rng = np.random.default_rng(2)
    values = rng.standard_normal(50)
    alone = figure_interval(mean, [judged(values)])
    tenfold = figure_interval(mean, [judged(np.repeat(values, 10), np.repeat(np.arange(50), 10))])
    assert tenfold.high - tenfold.low == pytest.approx(alone.high - alone.low, rel=0.05)


def test_difference_on_the_same_images_is_told_where_the_arms_are_not():
    rng = np.random.default_rng(3)
    hard = [rng.standard_normal(100) for _ in range(5)]
    first = [judged(one + 0.1) for one in hard]
    second = [judged(one) for one in hard]
    interval = difference_interval(mean, first, second)
    assert interval.low == pytest.approx(0.1) and interval.high == pytest.approx(0.1)
    each = figure_interval(mean, first)
    assert each.high - each.low > 0.2


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        ((0.1, 0.01, 0.2), "better"),
        ((-0.1, -0.2, -0.01), "**worse**"),
        ((0, -1, 1), "not significant"),
    ],
)
def test_verdicts_follow_from_intervals(interval, words):
    assert verdict(Interval(*interval)).startswith(words)


def test_f1_of_sums_is_that_of_the_confusion_matrix():
    rng = np.random.default_rng(4)
    truth, chance = rng.integers(0, 2, 200), rng.random(200)
    task = TASKS["polyp-classes"]
    features = task.features({"truth": truth.tolist(), "chance": chance.tolist()})
    exact = f1_scores(confusion_matrix((chance > 0.5).astype(int), truth, 2)).mean()
    assert task.figure_of(features.sum(axis=0)[None])[0] == pytest.approx(exact)


def test_depth_of_light_and_of_nothing():
    depth = np.tile(np.linspace(0.02, 0.06, 64), (64, 1))
    linear = 0.9 * (0.02 / depth) ** 2
    level = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    image = np.repeat(np.rint(255.0 * level)[..., None], 3, axis=-1).astype(np.uint8)
    row, column = np.mgrid[8:56, 8:56].reshape(2, -1)
    camera = Camera("front", LensPinhole(fx=60.0, fy=60.0, cx=31.5, cy=31.5), 64, 64)
    one = DepthImage(image, camera, np.column_stack([column, row]), depth[row, column], 0)
    by_cue, by_none = (depth_values(estimate, [one]) for estimate in (by_light, constant))
    assert by_cue["abs_rel"][0] < 0.03 and by_cue["rank"][0] > 0.99
    assert by_none["rank"] == [0.0]
    exact = np.mean(np.abs(depth - np.median(depth[row, column]))[row, column] / depth[row, column])
    assert by_none["abs_rel"][0] == pytest.approx(exact, abs=1e-4)


def test_a_black_border_is_left_out_and_rays_stay():
    image = np.zeros((60, 80, 3), np.uint8)
    image[10:50, 20:70] = 99
    camera = Camera("front", LensPinhole(fx=60.0, fy=60.0, cx=40.0, cy=31.0), 80, 60)
    pixels = np.array([[20, 10], [69, 49], [5, 30]])
    one = without_border(DepthImage(image, camera, pixels, np.array([1.0, 2.0, 3.0]), 0))
    assert one.image.shape == (40, 50, 3) and one.image.all()
    np.testing.assert_array_equal(one.pixels, [[0, 0], [49, 39]])
    given = ((camera, pixels[:2]), (one.camera, one.pixels))
    rays = [one.lens.unproject(places.astype(float)) for one, places in given]
    np.testing.assert_allclose(*rays)
    np.testing.assert_array_equal(one.depth, [1.0, 2.0])


def test_predict_writes_what_the_benchmark_scores(tmp_path):
    """On a whole image with border and insert, both crop the same part and use the same rays."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.checkpoint import TrainedNetwork
    from vrcaps.learn.networks import Backbone
    from vrcaps.learn.prediction import predict
    from vrcaps.learn.tasks.depth import DepthTask
    from vrcaps.recording.frame_files import read_image

    torch.manual_seed(0)
    learner = DepthTask(backbone=Backbone(32))
    trained = TrainedNetwork(learner, learner.network(is_pretrained=False).eval(), {})
    image = np.zeros((60, 80, 3), np.uint8)
    image[10:50, 20:70] = np.random.default_rng(0).integers(60, 220, (40, 50, 1)) * [1.0, 0.5, 0.4]
    image[36:50, 20:36] = (30, 60, 160)  # an insert of the device
    camera = Camera("front", LensPinhole(fx=60.0, fy=60.0, cx=40.0, cy=31.0), 80, 60)
    pixels = np.array([[25, 12], [69, 30], [60, 49], [22, 48], [5, 5]])
    one = without_border(DepthImage(image, camera, pixels, np.arange(1.0, 6.0), 0))
    np.testing.assert_array_equal(one.depth, [1.0, 2.0, 3.0])  # not in the insert or the border
    column, row = one.pixels.T
    scored = by_network(trained)(one.image, one.camera)[row, column]
    sequence = FrameSequence("a", ("rgb",), {"time": np.zeros(1)}, lambda *at: image, camera)
    predict(trained, (sequence,), tmp_path / "out")
    written = read_image(tmp_path / "out" / "a" / "000000.png") * 1e-5
    column, row = pixels[:3].T
    np.testing.assert_allclose(written[row, column], scored, atol=0.51e-5)
    assert (written[[48, 5], [22, 5]] == 0.0).all()


def write_sinus(folder):
    """Three points two and three units before a camera that has moved by one along x."""
    folder.mkdir()
    Image.fromarray(np.full((540, 960, 3), 90, np.uint8)).save(folder / "00000007.jpg")
    (folder / "structure.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nelement camera 1\n"
        "end_header\n1 0 2\n1.5 0 3\n1 0.5 2\n0 0 0\n"
    )
    (folder / "visible_view_indexes").write_text("7\n")
    (folder / "view_indexes_per_point").write_text("-1\n7\n-1\n7\n-1\n7\n")
    (folder / "camera_intrinsics_per_view").write_text("600\n600\n960\n540\n")
    pose = "position: {x: 1, y: 0, z: 0}\n    orientation: {x: 0, y: 0, z: 0, w: 1}\n"
    (folder / "motion.yaml").write_text(f"poses[]:\n  poses[0]:\n    {pose}")
    return folder


def test_points_of_the_sinus_data_fall_where_the_halved_calibration_says(tmp_path):
    (one,) = read_sinus(write_sinus(tmp_path / "sinus"))
    np.testing.assert_array_equal(one.pixels, [[480, 270], [530, 270], [480, 345]])
    np.testing.assert_allclose(one.depth, [2.0, 3.0, 2.0])
    (tmp_path / "sinus" / "motion.yaml").write_text("poses[]: {}\n")
    with pytest.raises(InputError, match="not in the layout of the sinus data"):
        read_sinus(tmp_path / "sinus")


def test_data_sets_are_found_by_name_or_named(tmp_path):
    for name in ("Kvasir-SEG", "hyper-kvasir-256", "WCEBleedGen", "other"):
        (tmp_path / name).mkdir()
    found = found_layouts(tmp_path, [f"bkai={tmp_path / 'other'}"])
    assert {*found} == {"kvasir_seg", "hyperkvasir", "wce_bleedgen", "bkai"}
    with pytest.raises(UnknownNameError, match="layout"):
        found_layouts(None, ["kvasir=x"])
    with pytest.raises(InputError, match=r"folder .* does not exist"):
        found_layouts(tmp_path / "missing", [])
    with pytest.raises(InputError, match="No known data set"):
        found_layouts(tmp_path / "other", [])


def test_variants_of_the_plan_lack_one_thing_each(tmp_path):
    base = read_plan(PLAN).scenario
    made = {name: without(name, base, tmp_path) for name in VARIANTS}
    assert made[COMPLETE] == base
    assert made["indirect light"]["render"] == {"light": "direct"}
    assert made["lens and sensor effects"]["effects"] == "none,ae=settled"
    assert "contents" not in made["contents"]
    assert (tmp_path / "texture" / "mucosa.json").is_file()
    shapes = {one["shape"] for one in made["shapes of polyps"]["lesions"] if one["kind"] == "polyp"}
    assert shapes == {"IIb"}
    for name in VARIANTS:
        differs = [key for key in {**base, **made[name]} if made[name].get(key) != base.get(key)]
        assert len(differs) == (name != COMPLETE)


def test_real_folders_become_pictures(tmp_path):
    real = write_real(tmp_path)
    masks = read_masks(real / "kvasir_seg", 32, "polyp")
    assert len(masks) == 16 and masks.images[0].shape == (32, 32, 3)
    assert masks.masks[0].shape == (32, 32) and masks.masks[0].any()
    assert {*masks.folds} == set(range(5))
    classes = read_classes(real / "hyperkvasir", kvasir_class, 32, has_overlays=True)
    assert {*classes.classes} == {"polyp", "colitis"} and len(classes) == 11
    assert not classes.images[0][20:, :15].any()
    with pytest.raises(InputError, match="contains no images with masks"):
        read_masks(real / "hyperkvasir", 32, "polyp")


def our_sequence(split):
    """Frames of a patient with a polyp and a bleeding; every second frame shows one of them."""
    plain = small_sequence(seed=1, name=split, split=split)
    lesions = [{"instance": 1, "kind": "polyp"}, {"instance": 2, "kind": "bleeding"}]

    def load(channel, index):
        image = plain.load(channel, index)
        return image * (1 + index // 2 % 2) if channel == "instance" else image

    episode = SimpleNamespace(head={"organ": {"lesions": lesions}})
    return replace(plain, load=load, episode=episode)


def test_our_images_have_the_classes_and_masks_of_their_lesions(monkeypatch):
    dataset = SimpleNamespace(sequences=lambda split: (our_sequence(split),))
    monkeypatch.setattr(simulated.vrcaps.data, "open", lambda url: dataset)
    classes, _ = our_classes(("made-up",), ("normal", "bleeding"), 32)
    assert [classes.classes.count(name) for name in ("normal", "bleeding")] == [10, 5]
    masks, _ = our_masks(("made-up",), ("polyp",), 32)
    assert sum(mask.any() for mask in masks.masks) == 5
    assert masks.masks[0].shape == masks.images[0].shape[:2] == (32, 32)
    both, _ = our_masks(("made-up",), ("bleeding", "polyp"), 32)
    assert {*np.unique(both.masks)} == {0, 1, 2}
    sequence = both.sequence()
    assert sequence.label_names == ("background", "bleeding", "polyp")
    shown = [[name in found for name in (1, 2)] for found in map(np.unique, both.masks)]
    assert np.sum(shown, axis=0).tolist() == [5, 5]
    any_lesion, _ = our_masks(("made-up",), ("lesion",), 32)
    for one, each in zip(any_lesion.masks, both.masks, strict=True):
        assert np.array_equal(one, each > 0)
    with pytest.raises(InputError, match="no image of colitis to learn from"):
        our_masks(("made-up",), ("colitis",), 32)


def fake_dataset(monkeypatch):
    """A data set whose patients have a polyp and a bleeding."""

    class Fake(list):
        plan: ClassVar = {"dataset": {"name": "fake"}}

        def sequences(self, split):
            return (our_sequence(split),)

    members = Fake([SimpleNamespace(name="p00000-000000")])
    monkeypatch.setattr(simulated.vrcaps.data, "open", lambda url: members)


def test_what_tasks_learn_alike_on_ours_is_learned_once(monkeypatch, tmp_path):
    fake_dataset(monkeypatch)
    setup = Setup({}, tmp_path, ("once",))

    def folder(task, arm="ours", seed=0):
        cell = Cell(task, arm, 0.1, seed)
        learners = TASKS[task].first_learners(setup.effort(TASKS[task]))
        return first_folder(setup, cell, learners[-1])

    assert folder("polyp-masks") == folder("bleeding-masks", seed=3)
    assert folder("polyp-classes") == folder("bleeding-classes") != folder("polyp-masks")
    assert folder("polyp-masks", "imagenet+ours") != folder("polyp-masks")


@pytest.mark.slow
@pytest.mark.usefixtures("plain_stamp")
def test_a_run_with_ours_learns_masks_first(tmp_path, monkeypatch):
    pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")
    fake_dataset(monkeypatch)
    write_real(tmp_path / "real")
    page, run = tmp_path / "page.md", tmp_path / "run"
    command = ["sim_to_real.py", "--real", str(tmp_path / "real"), "--run", str(run)]
    command += ["--preset", "smoke", "--fractions", "0.5", "--seeds", "1", "--out", str(page)]
    command += ["--ours", "fake", "--tasks", "polyp-masks"]
    monkeypatch.setattr(sys, "argv", command)
    sim_to_real.main()
    arms = [(row.cell.arm, row.cell.fraction) for row in RowFile(run).rows.values()]
    named = [(arm, 0.5) for arm in TASKS["polyp-masks"].arms]
    assert sorted(arms) == sorted([*named, ("ours", 0.0), ("imagenet+ours", 0.0)])
    first = [*(run / "weights").glob("segmentation-ours-*")]
    learners = [read_weights(one / WEIGHTS).task for one in first]
    assert {(one.classes, one.backbone.size) for one in learners} == {
        (OUR_LESIONS, 32),
        ((LESION,), 32),
    }
    given = tmp_path / "given"
    given.mkdir()
    shutil.copy(first[0] / WEIGHTS, given / "masks-scratch.safetensors")
    setup = Setup({}, run, ("fake",), given, "smoke")
    found = first_weights(setup, Cell("bleeding-masks", "ours", 0.5, 0))
    assert found == str(given / "masks-scratch.safetensors")


def test_our_images_without_instances_are_refused(monkeypatch):
    plain = small_sequence(split="train").with_channels(("rgb", "depth"))
    dataset = SimpleNamespace(sequences=lambda split: (plain,))
    monkeypatch.setattr(simulated.vrcaps.data, "open", lambda url: dataset)
    with pytest.raises(InputError, match="lacks the channel 'instance'"):
        our_masks(("without-instances",), ("polyp",), 32)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--tasks", "nope"], "No task named 'nope'"),
        (["--fractions", "0"], "above 0, at most 1"),
        (["--tasks", "super-resolution"], "There is no data for these tasks"),
    ],
)
def test_what_cannot_run_is_told_on_one_line(tmp_path, monkeypatch, words, message):
    (tmp_path / "kvasir-seg").mkdir()
    command = ["sim_to_real.py", "--real", str(tmp_path), "--run", str(tmp_path / "run"), *words]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit, match=message):
        sim_to_real.main()


@pytest.mark.slow
@pytest.mark.usefixtures("plain_stamp")
def test_a_run_goes_on_and_writes_its_page(tmp_path, monkeypatch, capsys):
    pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")
    write_real(tmp_path / "real")
    page, run = tmp_path / "docs" / "page.md", tmp_path / "run"
    command = ["sim_to_real.py", "--real", str(tmp_path / "real"), "--run", str(run)]
    command += ["--preset", "smoke", "--fractions", "0.5", "--seeds", "1", "--out", str(page)]
    monkeypatch.setattr(sys, "argv", [*command, "--tasks", "polyp-classes"])
    sim_to_real.main()
    lines = (run / ROWS).read_text().splitlines()
    assert len(lines) == 2
    text = page.read_text()
    assert "Classification of polyps and colitis" in text and "| 50 % |" in text
    (run / ROWS).write_text("\n".join(lines[:-1]) + "\n")
    capsys.readouterr()
    sim_to_real.main()
    assert "2 networks, 1 of them known." in capsys.readouterr().out
    again = (run / ROWS).read_text().splitlines()
    assert [{**json.loads(x), "seconds": 0} for x in again] == [
        {**json.loads(x), "seconds": 0} for x in lines
    ]


def test_ablations_show_changes_on_the_same_images():
    rows = []
    for variant, dice in ((COMPLETE, 0.6), ("texture", 0.5)):
        for seed in range(3):
            cell = Cell("polyp-masks", "ours", 0.1, seed, variant)
            made_of = {"basis": "a", "first": variant, "preset": "quick"}
            values = {"dice": [dice + 0.01 * seed] * 8}
            rows.append(Row(cell, made_of, values, [*range(8)], 1.0))
            depth = Cell("depth", "ours", 0.0, seed, variant)
            values = {"c3vd_abs_rel": [0.8 - dice + 0.01 * seed]}
            rows.append(Row(depth, made_of, values, [], 1.0))
    text = ablate.page_text(rows)
    assert "| nothing | 61.0 [60.0, 62.0] |" in text
    assert "| texture | **-10.0 [-10.0, -10.0]** |" in text
    assert "| texture | **+0.100 [+0.100, +0.100]** |" in text
    assert "| contents |  |" in text


def test_ablations_are_of_tasks_with_real_images():
    cells = ablate.cells_of([*TASKS, "depth"], ["kvasir_seg", "sinus"], 2)
    assert {cell.task for cell in cells} == {"polyp-masks", "depth"}
    assert len(cells) == 2 * 2 * len(VARIANTS)
    assert {cell.fraction for cell in cells if cell.task == "depth"} == {0.0}
    with pytest.raises(InputError, match="There is no data for these tasks"):
        ablate.cells_of(["super-resolution"], ["bkai"], 1)


def test_a_task_without_rows_keeps_its_section(tmp_path):
    def row(task, arm, seed):
        made_of = {"basis": "a", "first": "", "preset": "quick"}
        return Row(Cell(task, arm, 0.1, seed), made_of, {"dice": [0.5] * 8}, [*range(8)], 1.0)

    page = tmp_path / "page.md"
    report([row("polyp-masks", "ours", seed) for seed in range(5)], page)
    before = read_sections(page)["benchmarks.sim_to_real polyp-masks"]
    arms = ("ours", "scratch")
    report([row("bleeding-masks", arm, seed) for arm in arms for seed in range(5)], page)
    sections = read_sections(page)
    assert sections["benchmarks.sim_to_real polyp-masks"] == before
    found = sections["benchmarks.sim_to_real bleeding-masks"]
    assert "| 10 % | 50.0 [50.0, 50.0] | 50.0 [50.0, 50.0] |" in found
    assert "- 10 % of the real images: ours − from scratch is +0.0" in found
    assert "| classes |" not in found
