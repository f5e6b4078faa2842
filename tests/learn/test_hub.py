"""Published weights: found by name, checked, with a card that says how to make them again."""

import csv
import hashlib
import json
import shutil
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
import yaml

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from tests.support.small_frames import small_sequence  # noqa: E402
from vrcaps import cli  # noqa: E402
from vrcaps.cli.parts import part_of  # noqa: E402
from vrcaps.config.plain_files import front_matter  # noqa: E402
from vrcaps.core.errors import InputError, StorageError, UnknownNameError  # noqa: E402
from vrcaps.core.files import file_sha256, files_in  # noqa: E402
from vrcaps.learn import hub, publishing  # noqa: E402
from vrcaps.learn.augment import Augmentation  # noqa: E402
from vrcaps.learn.checkpoint import read_weights  # noqa: E402
from vrcaps.learn.evaluation import Evaluation, write_evaluation  # noqa: E402
from vrcaps.learn.hub import INDEX, VARIABLE, find_weights, pull, read_index  # noqa: E402
from vrcaps.learn.model_card import train_command  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.publishing import MAX_BYTES, publish  # noqa: E402
from vrcaps.learn.samples import samples_of  # noqa: E402
from vrcaps.learn.settings import TrainSettings, settings_of  # noqa: E402
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.depth import DepthTask  # noqa: E402
from vrcaps.learn.tasks.segmentation import SegmentationTask  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402
from vrcaps.learn.training import BEST, train  # noqa: E402
from vrcaps.recording.frame_files import write_images  # noqa: E402
from vrcaps.scenario.settings import parse_change  # noqa: E402
from vrcaps.training import ComputeSettings  # noqa: E402

TASK = "super-resolution"
LEARNER = SuperResolutionTask(2, size=32, blocks=1, features=8)
OURS = Path(__file__).parents[2] / "weights"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A training of two steps."""
    out = tmp_path_factory.mktemp("training") / "run"
    settings = TrainSettings(
        LEARNER, data=("runs/cohort",), start="scratch", steps=2, batch=2, evaluate_every=2
    )
    samples = samples_of(LEARNER, [small_sequence()])
    train(settings, samples, samples, out, compute=ComputeSettings("cpu"))
    return out


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A new folder of published weights."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "weights"))
    return tmp_path / "weights"


def _evaluated(folder, sha256, psnr=31.25):
    folder.mkdir()
    scores = {"psnr": psnr, "ssim": float("nan")}
    write_evaluation(folder, Evaluation(TASK, sha256, ("runs/cohort",), "test", 7, 1, scores))
    return folder


def test_published_weights_are_found_by_task_and_name(run, place):
    publish(run, place, notes="For tests.")
    publish(run, place, name="super-resolution-mine", notes="For tests.")
    assert list(read_index(str(place))) == ["super-resolution", "super-resolution-mine"]
    for given in ("", "super-resolution", "super-resolution-mine"):
        found = find_weights(given, TASK)
        assert found == place / f"{given or TASK}.safetensors"
        assert found.read_bytes() == (run / BEST).read_bytes()
    assert find_weights(str(run / BEST), TASK) == run / BEST


def test_card_states_training_and_metrics(run, place, tmp_path):
    scored = _evaluated(tmp_path / "scored", file_sha256(run / BEST))
    entry = publish(run, place, evaluations=[scored], notes="# Use\nOnly in tests.")
    assert entry.summary.endswith("psnr 31.2500 on cohort")
    card = (place / "super-resolution.md").read_text()
    settings = json.loads((run / "settings.json").read_text())["settings"]
    validation = float((run / "progress.csv").read_text().splitlines()[1].split(",")[2])
    for said in (
        entry.sha256,
        f"{settings['frames'][0]} frames of `runs/cohort`",
        "7 frames of `runs/cohort`, test",
        f"| psnr | {validation:.4g} | 31.25 |",
        "| input | `image` | color from 0 to 1",
        "factor 2, size 32",
        "Apache-2.0",
        "Only in tests.",
    ):
        assert said in card
    again = publish(run, place, license_name="CC-BY-4.0")
    text = (place / "super-resolution.md").read_text()
    assert "CC-BY-4.0" in text and text.count("Only in tests.") == 1
    assert again.sha256 == entry.sha256
    publish(run, place, notes="Other.")
    assert "Only in tests." not in (place / "super-resolution.md").read_text()


DAMAGE = [
    *(("settings.json", "frames", frames) for frames in ([10, "two"], [-5, 5], "ab", [None] * 2)),
    ("settings.json", "frames", [float("nan"), 1]),
    ("settings.json", "made_with", ["vrcaps"]),
    ("settings.json", "made_with", {"torch": "2.0\n\n# injected"}),
    *(("progress.csv", "step", step) for step in ("inf", "-5", "1" * 200_000)),
]


@pytest.mark.parametrize(("file", "key", "value"), DAMAGE)
def test_a_damaged_training_is_one_line_and_keeps_what_is_published(
    run, place, tmp_path, file, key, value
):
    publish(run, place, notes="For tests.")
    before = {path.name: path.read_bytes() for path in files_in(place)}
    damaged = tmp_path / "damaged"
    shutil.copytree(run, damaged)
    if file == "progress.csv":
        rows = list(csv.reader((damaged / file).read_text().splitlines()))
        rows[-1][rows[0].index(key)] = value
        (damaged / file).write_text("\n".join(map(",".join, rows)))
    else:
        stated = json.loads((damaged / file).read_text())
        (stated["settings"] if key == "frames" else stated)[key] = value
        (damaged / file).write_text(json.dumps(stated))
    with pytest.raises(InputError, match=r"The training in .* is damaged: ") as error:
        publish(damaged, place, notes="Other.")
    assert "\n" not in str(error.value)
    assert {path.name: path.read_bytes() for path in files_in(place)} == before


def header_and_body(card):
    """Header of a card as PyYAML reads it, and the text after it."""
    start, header, body = card.split("---\n", 2)
    assert not start
    return yaml.safe_load(header), body


def headings(body):
    return [line for line in body.splitlines() if line.startswith("## ")]


GENERATED = [
    *("## Model description", "## How to use", "## Training data"),
    *("## Training procedure", "## Evaluation results", "## Intended uses & limitations"),
]
"""Sections of each card, in the template of the Hub; the last one is written by hand."""


def test_header_of_a_card_has_the_metadata_of_the_hub(run, place, tmp_path):
    scored = _evaluated(tmp_path / "scored", file_sha256(run / BEST))
    publish(run, place, evaluations=[scored], notes="Only in tests.")
    header, body = header_and_body((place / "super-resolution.md").read_text())
    assert header.pop("tags")[0] == "vrcaps"
    result = {
        "task": {"type": "image-to-image"},
        "dataset": {"type": "cohort", "name": "cohort", "split": "test"},
        "metrics": [{"type": "psnr", "value": 31.25}],  # ssim is not finite
    }
    assert header == {
        "license": "apache-2.0",
        "library_name": "vrcaps",
        "pipeline_tag": "image-to-image",
        "datasets": ["cohort"],
        "metrics": ["psnr"],
        "model-index": [{"name": "super-resolution", "results": [result]}],
    }
    assert headings(body) == GENERATED
    publish(run, place, license_name="CC-BY-4.0")
    header, body = header_and_body((place / "super-resolution.md").read_text())
    assert (header["license"], header["metrics"]) == ("cc-by-4.0", ["psnr"])
    assert "model-index" not in header
    assert headings(body) == GENERATED


def test_card_holds_the_plan_of_its_data(run, place, tmp_path):
    plan = {"dataset": {"name": "forty"}, "scenario": {"frames": 80}, "made_with": {"numpy": "2"}}
    (tmp_path / "cohort").mkdir()
    (tmp_path / "cohort" / "plan.json").write_text(json.dumps(plan))
    mine = shutil.copytree(run, tmp_path / "mine")
    text = (mine / "settings.json").read_text()
    (mine / "settings.json").write_text(text.replace("runs/cohort", str(tmp_path / "cohort")))
    publish(mine, place, notes="n")
    block = (place / "super-resolution.md").read_text().split("```json\n")[1].split("```")[0]
    assert json.loads(block) == {key: plan[key] for key in ("dataset", "scenario")}


@pytest.mark.parametrize(
    "settings",
    [
        TrainSettings(DepthTask()),
        TrainSettings(
            DepthTask(backbone=Backbone(256), has_light_cue=False), ("runs/a b", "c3vd:d"), ("v",)
        ),
        TrainSettings(
            SegmentationTask(("polyp", "ulcer")),
            ("a",),
            start="segmentation",
            steps=7,
            learning_rate=1e-4,
        ),
        TrainSettings(ClassificationTask(("normal", "bleeding")), ("a",), start="scratch", seed=3),
        TrainSettings(SfmTask(step=2), ("a",), fraction=0.1, weight_decay=0.0),
        TrainSettings(
            DepthTask(augmentation=Augmentation(gamma_jitter=1.0)),
            ("a",),
            start="depth",
            freeze_batch_norm=True,
        ),
        TrainSettings(replace(LEARNER, validation_size=64), ("a",), batch=3),
    ],
    ids=lambda settings: settings.task.kind,
)
def test_command_of_a_card_gives_its_settings(settings):
    import shlex

    settings = replace(settings, data=settings.data or ("runs/cohort",))
    command = cli._parse(shlex.split(train_command(settings, "out"))[1:])
    found = settings_of(
        part_of(command),
        command.preset,
        command.data,
        command.start,
        map(parse_change, command.set),
        validation=command.validation,
    )
    assert found == settings


def test_command_predicts_with_published_weights(run, place, tmp_path, capsys):
    publish(run, place, notes="For tests.")
    image = small_sequence().image("rgb", 1)
    photos, out = tmp_path / "photos", tmp_path / "large"
    photos.mkdir()
    write_images([(photos / "one.png", image)])
    for number, images in enumerate((photos, f"images:{photos}")):
        large = out / str(number)
        cli.main(["predict", TASK, "--images", str(images), "--out", str(large)])
        assert {path.name for path in files_in(large)} == {"one.png", "sheet.png"}
    with pytest.raises(SystemExit):
        cli.main(["predict", TASK, "--images", str(photos), "--out", str(photos / "large")])
    assert "that is read. Allowed: a folder elsewhere" in " ".join(capsys.readouterr().err.split())
    assert {path.name for path in photos.iterdir()} == {"one.png"}
    cli.main(["weights", "list"])
    said = " ".join(capsys.readouterr().out.split())
    assert TASK in said and "1 in " in said


def test_training_is_initialized_from_published_weights(run, place):
    publish(run, place, notes="For tests.")
    from vrcaps.learn.checkpoint import read_weights
    from vrcaps.learn.initialize import initialized_network

    first = initialized_network(LEARNER, TASK).state_dict()
    expected = read_weights(run / BEST).network.state_dict()
    assert all(torch.equal(first[name], expected[name]) for name in expected)


def test_weights_at_a_url_are_kept_in_the_cache(run, place, tmp_path, monkeypatch):
    fsspec = pytest.importorskip("fsspec")
    publish(run, place, notes="For tests.")
    memory = fsspec.filesystem("memory")
    for path in files_in(place):
        memory.pipe(f"/published/{path.name}", path.read_bytes())
    monkeypatch.setenv(VARIABLE, "memory://published/")
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path / "cache"))
    found = find_weights("", TASK)
    assert found.is_relative_to(tmp_path / "cache")
    assert found.read_bytes() == (run / BEST).read_bytes()
    found.write_bytes(b"cut")
    assert find_weights("", TASK).read_bytes() == (run / BEST).read_bytes()
    memory.rm("/published/super-resolution.safetensors")
    assert find_weights("", TASK) == found
    found.unlink()
    with pytest.raises(
        InputError, match=r"memory://published, .* contains no super-resolution\.safetensors"
    ):
        find_weights("", TASK)
    with pytest.raises(InputError, match=r"is not a local folder\. Give --out"):
        cli._parse(["weights", "publish", str(run)]).run()


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A user of an installed package: no checkout, an own data folder."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(hub, "_CHECKOUT", tmp_path / "none")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setattr(hub, "download_folder", lambda: tmp_path / "data" / "weights")
    return tmp_path / "data" / "weights"


def test_pulled_weights_are_found_by_name(run, tmp_path, home, capsys):
    source = tmp_path / "source"
    publish(run, source, notes="For tests.")
    with pytest.raises(InputError, match=r"Fetch them with `vrcaps weights pull --from URL`"):
        find_weights("", TASK)
    cli.main(["weights", "pull", "--from", str(source)])
    assert f"1 files, 0.0 MB, in {home}: {TASK}." in " ".join(capsys.readouterr().out.split())
    assert find_weights("", TASK).read_bytes() == (run / BEST).read_bytes()
    assert find_weights(TASK) == home / f"{TASK}.safetensors"
    assert (home / f"{TASK}.md").read_bytes() == (source / f"{TASK}.md").read_bytes()


def test_complete_files_are_not_copied_again(run, tmp_path, home, monkeypatch):
    source = tmp_path / "source"
    publish(run, source, notes="For tests.")
    pull(str(source))
    (source / f"{TASK}.safetensors").unlink()
    (entry,) = pull(str(source))
    assert entry.name == TASK
    (home / f"{TASK}.safetensors").write_bytes(b"cut")
    with pytest.raises(InputError, match=rf"contains no {TASK}\.safetensors"):
        pull(str(source))


def test_other_content_than_the_index_states_is_refused(run, tmp_path, home):
    source = tmp_path / "source"
    publish(run, source, notes="For tests.")
    path = source / f"{TASK}.safetensors"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(InputError, match=r"has sha256 .*, but index\.json states .* Try again"):
        pull(str(source))
    assert not (home / f"{TASK}.safetensors").exists()


def test_a_pull_needs_a_source_and_known_names(run, tmp_path, home):
    source = tmp_path / "source"
    publish(run, source, notes="For tests.")
    with pytest.raises(UnknownNameError, match="No published weights named 'dept'"):
        pull(str(source), ["dept"])
    with pytest.raises(InputError, match=r"No source is given\. Add --from FOLDER"):
        cli._parse(["weights", "pull"]).run()
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(StorageError, match=r"Cannot write .*: Not a directory\. Give another"):
        pull(str(source), folder=blocked / "weights")


def serve(folder):
    """Serve a folder on this machine; return the server and its URL."""
    handler = partial(QuietHandler, directory=str(folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    Thread(target=server.serve_forever, daemon=True).start()
    return server, f"http://127.0.0.1:{server.server_address[1]}"


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *args):
        pass


def test_weights_of_a_web_server_are_pulled(run, tmp_path, home):
    source = tmp_path / "source"
    publish(run, source, notes="For tests.")
    server, url = serve(source)
    with server:
        pull(url)
        assert find_weights("", TASK).read_bytes() == (run / BEST).read_bytes()
        (home / f"{TASK}.safetensors").unlink()
        with (source / f"{TASK}.safetensors").open("ab") as file:
            file.write(b"more than the index states")
        with pytest.raises(StorageError, match=r"has more than \d+ bytes"):
            pull(url)
        (source / "index.json").unlink()
        with pytest.raises(InputError, match=r"http://127.* contains no index\.json"):
            pull(url)
        server.shutdown()
    with pytest.raises(StorageError, match=r"from http://127.*: Connection refused\. Set VRCAPS_W"):
        pull(url)


def test_files_larger_than_an_index_are_read_from_a_web_server(tmp_path, home, monkeypatch):
    source, data = tmp_path / "source", bytes(1_200_000)
    source.mkdir()
    (source / f"{TASK}.safetensors").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    entry = hub.PublishedWeights(TASK, TASK, f"{TASK}.safetensors", digest, len(data), "zeros")
    hub.add_to_index(source, entry)
    server, url = serve(source)
    monkeypatch.setenv(VARIABLE, url)
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path / "cache"))
    with server:
        assert find_weights(TASK).read_bytes() == data
        server.shutdown()


def test_an_unreachable_location_is_one_line(monkeypatch):
    fsspec = pytest.importorskip("fsspec")

    def fail(self, path, **more):
        raise ConnectionError("No route to host")

    monkeypatch.setattr(fsspec.get_filesystem_class("memory"), "cat_file", fail)
    monkeypatch.setenv(VARIABLE, "memory://published")
    with pytest.raises(StorageError, match=r"from memory://published: No route to host\. Set VRCA"):
        find_weights("", TASK)


def test_missing_published_weights_are_one_line(run, place, monkeypatch):
    with pytest.raises(InputError, match=r"weights, .* contains no index\.json"):
        find_weights("", TASK)
    publish(run, place, notes="For tests.")
    with pytest.raises(InputError, match=r"No weights of the task 'depth' are published in"):
        find_weights("", "depth")
    with pytest.raises(UnknownNameError, match="No file or published weights named 'super'"):
        find_weights("super", TASK)
    path = place / "super-resolution.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"has sha256 .*, but index\.json states"):
        find_weights("", TASK)
    path.unlink()
    with pytest.raises(InputError, match="is missing, but index"):
        find_weights("", TASK)
    (place / INDEX).write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        find_weights("", TASK)
    (place / INDEX).write_text('{"format": "other/1", "weights": []}')
    with pytest.raises(InputError, match=r"format is other/1\. Allowed: vrcaps-published/1"):
        find_weights("", TASK)
    entry = {"name": TASK, "task": TASK, "file": f"{TASK}.safetensors", "bytes": 1, "summary": ""}
    entry["sha256"] = "/../../../../x"
    (place / INDEX).write_text(json.dumps({"format": "vrcaps-published/1", "weights": [entry]}))
    with pytest.raises(InputError, match=r"sha256 is '/../../../../x'\. Allowed: 64 hexadecimal"):
        find_weights("", TASK)
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr("vrcaps.learn.hub._CHECKOUT", place / "none")
    with pytest.raises(InputError, match=r"Fetch them with `vrcaps weights pull"):
        find_weights("", TASK)


def test_a_training_that_cannot_be_published_is_one_line(run, place, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"has no notes\. Give --notes FILE"):
        publish(run, place)
    with pytest.raises(InputError, match=r"weights is depth\. Allowed: super-resolution, or"):
        publish(run, place, name="depth", notes="n")
    with pytest.raises(InputError, match=r"contains no best\.safetensors"):
        publish(tmp_path, place, notes="n")
    scored = _evaluated(tmp_path / "scored", "0" * 64)
    with pytest.raises(InputError, match=r"belongs to weights with sha256 000000000000…, not"):
        publish(run, place, notes="n", evaluations=[scored])
    with pytest.raises(InputError, match=r"contains no evaluation\.json"):
        publish(run, place, notes="n", evaluations=[tmp_path])
    (scored / "evaluation.json").write_text('{"scores": {}}')
    with pytest.raises(InputError, match=r"evaluation file .* is damaged"):
        publish(run, place, notes="n", evaluations=[scored])
    broken = shutil.copytree(run, tmp_path / "broken")
    (broken / "progress.csv").write_text("step\n")
    with pytest.raises(InputError, match="is damaged"):
        publish(broken, place, notes="n")
    (broken / "progress.csv").unlink()
    with pytest.raises(InputError, match=r"Cannot read .*progress\.csv"):
        publish(broken, place, notes="n")
    monkeypatch.setattr(publishing, "MAX_BYTES", 10)
    with pytest.raises(InputError, match="Allowed: up to 10; train a smaller encoder"):
        publish(run, place, notes="n")
    assert not place.exists()


def test_our_published_weights_are_whole_and_have_cards():
    for entry in read_index(str(OURS)).values():
        path = OURS / entry.file
        assert (file_sha256(path), path.stat().st_size) == (entry.sha256, entry.bytes)
        assert entry.bytes <= MAX_BYTES
        assert entry.sha256 in (OURS / f"{entry.name}.md").read_text("utf-8")
    named = {path.name for path in OURS.iterdir() if path.is_file()} - {INDEX}
    assert named == {
        f"{name}{end}" for name in read_index(str(OURS)) for end in (".md", ".safetensors")
    }


RESEARCH_ONLY = {"segmentation-bleeding"}
"""Weights trained on images that are for research only."""


@pytest.mark.parametrize("name", sorted(path.stem for path in OURS.glob("*.md")))
def test_our_cards_are_as_the_generator_writes_them(name):
    text = (OURS / f"{name}.md").read_text("utf-8")
    entry = read_index(str(OURS))[name]
    trained = read_weights(OURS / entry.file)
    header, body = header_and_body(text)
    assert text.startswith(front_matter(header))
    license_id = "other" if name in RESEARCH_ONLY else "apache-2.0"
    assert (header["license"], header["library_name"]) == (license_id, "vrcaps")
    assert header["pipeline_tag"] == trained.task.pipeline_tag
    is_pretrained = trained.metadata.get("origin") == "imagenet"
    assert header.get("base_model") == (
        "timm/tf_efficientnet_lite0.in1k" if is_pretrained else None
    )
    assert header["datasets"] == [Path(source).name for source in trained.metadata["data"]]
    (result,) = header["model-index"][0]["results"]
    assert {one["type"] for one in result["metrics"]} == set(header["metrics"])
    score = next(x["value"] for x in result["metrics"] if x["type"] == trained.task.metric.name)
    stated = entry.summary.partition(f"; {trained.task.metric.name} ")[2].split()[0]
    assert score == pytest.approx(float(stated), rel=1e-3)
    assert headings(body)[: len(GENERATED)] == GENERATED
    for metric, value in trained.metadata["scores"].items():
        assert f"| {metric} | {value:.4g} |" in body


def test_former_checkpoints_are_read():
    """The published files still have the former names of tasks and settings."""
    for entry in read_index(str(OURS)).values():
        assert read_weights(OURS / entry.file).task.kind == entry.task
