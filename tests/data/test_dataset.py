"""Data sets are read where they lie: in a folder, or at a URL."""

import functools
import http.server
import multiprocessing
import pickle
import threading

import numpy as np
import pytest

import vrcaps
from tests.support.waiting import WATCHDOG
from vrcaps.cli import console, main
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.files import files_in
from vrcaps.data.store import open_store, read_at_once
from vrcaps.formats.io import read_sources
from vrcaps.recording.episode import read_episode


@pytest.fixture(scope="module")
def remote(whole):
    """The data set at a URL of the memory of this process."""
    store = open_store("memory://reading/tubes")
    for path in files_in(whole):
        store.write(path.relative_to(whole).as_posix(), path.read_bytes())
    return store.url


@pytest.fixture
def served(whole):
    """The data set at a URL of a web server, and the names that were asked for."""
    asked = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            asked.append(self.path)

    handler = functools.partial(Handler, directory=str(whole))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=[0.02])
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}", asked
        server.shutdown()
        thread.join()


def test_a_url_gives_what_the_folder_gives(whole, remote):
    here, there = vrcaps.data.open(whole), vrcaps.data.open(remote)
    assert there.url == remote
    assert (there.plan, len(there)) == (here.plan, len(here))
    assert there.patients("train") == here.patients("train")
    for ours, theirs in zip(here.sequences("test"), there.sequences("test"), strict=True):
        assert (ours.name, ours.patient, ours.split) == (theirs.name, theirs.patient, "test")
        assert ours.camera == theirs.camera
        for name, expected in ours[1].items():
            np.testing.assert_array_equal(theirs[1][name], expected)
    member = there.members()[0]
    assert member.read().organ.vertices.shape == here.members()[0].read().organ.vertices.shape


def test_sequences_of_takes_episodes_and_data_sets_of_all_places(whole, remote):
    name = vrcaps.data.open(whole).members()[0].name
    for root in (whole, f"file://{whole}", remote):
        assert len(vrcaps.data.sequences_of(root)) == 16
        assert len(vrcaps.data.sequences_of(root, split="val", camera="rear")) == 2
        front, rear = vrcaps.data.sequences_of(f"{root}/episodes/{name}")
        assert (front.name, rear.name) == (f"{name}/front", f"{name}/rear")
        assert front.image("rgb", 0).shape == (36, 40, 3)
        assert len(front.episode.organ.vertices) > 0  # which the data set's episodes share


def test_only_what_is_asked_for_is_fetched(served):
    url, asked = served
    sequence = vrcaps.data.open(url).sequences(camera="front")[0].with_channels(["depth"])
    asked.clear()
    assert sequence[2]["depth"].shape == (36, 40)
    assert [path.partition("/front/")[2] for path in asked] == ["depth/000002.png"]


def test_processes_forked_after_a_read_read_too(served):
    """Neither connections nor threads of the core come along."""
    sequence = vrcaps.data.open(served[0]).sequences()[0]
    expected = sequence[0]["rgb"]
    context = multiprocessing.get_context("fork")
    with context.Pool(1) as pool:
        found = pool.apply_async(sequence.image, ("rgb", 0)).get(timeout=WATCHDOG)
    np.testing.assert_array_equal(found, expected)


def test_tables_of_several_recordings_are_read_at_once(whole):
    """Each of two waits for the other: if they came one after the other, both would fail."""
    meeting = threading.Barrier(2, timeout=WATCHDOG)
    episodes = [
        read_episode(Meeting(member.files, meeting))
        for member in vrcaps.data.open(whole).members()[:2]
    ]
    shown: list[tuple[int, int]] = []
    found = read_at_once(
        lambda episode: len(episode.table), episodes, lambda *counts: shown.append(counts)
    )
    assert found == [3, 3]
    assert shown == [(1, 2), (2, 2)]


def test_a_source_shows_how_many_recordings_are_read(whole):
    shown: list[tuple[int, int]] = []
    sequences = read_sources([str(whole)], lambda *counts: shown.append(counts))
    assert len(sequences) == 16
    assert shown == [(done, 8) for done in range(1, 9)]


@pytest.mark.parametrize(
    "command",
    [
        "dataset composite {0} --into {0} --out {1}",
        "predict segmentation --images {0} --weights {0}/weights.safetensors --out {1}",
    ],
)
def test_a_command_shows_how_many_recordings_are_read(
    whole, command, tmp_path, monkeypatch, capsys
):
    """Both then stop: the data have no twins, and the file holds no weights."""
    monkeypatch.setattr(console, "PERIOD", 0.0)
    monkeypatch.setattr("vrcaps.learn.hub.find_weights", lambda *_: tmp_path / "none.safetensors")
    with pytest.raises(SystemExit, match="2"):
        main(command.format(whole, tmp_path / "out").split())
    assert "reading: 8/8 after" in capsys.readouterr().err


class Meeting:
    """Files of which the table is there when two have asked for one."""

    def __init__(self, files, meeting):
        self.files, self.url, self.meeting = files, files.url, meeting

    def read(self, name):
        if name == "frames.parquet":
            self.meeting.wait()
        return self.files.read(name)


def test_sequences_go_to_other_processes_as_bytes(remote):
    sequence = vrcaps.data.open(remote).sequences()[0]
    copy = pickle.loads(pickle.dumps(sequence))
    np.testing.assert_array_equal(copy[0]["depth"], sequence[0]["depth"])


def test_exports_read_urls(remote, tmp_path):
    words = ["--out", str(tmp_path / "shards"), "--split", "val", "--camera", "rear"]
    main(["export", "webdataset", remote, *words])
    (found, other) = vrcaps.read_format("webdataset", tmp_path / "shards")
    expected = vrcaps.data.open(remote).sequences("val", "rear")
    assert {found.name, other.name} == {one.name for one in expected}
    np.testing.assert_array_equal(found[0]["rgb"], expected[0][0]["rgb"])


def test_what_cannot_be_read_is_one_clear_line(remote, tmp_path):
    dataset = vrcaps.data.open(remote)
    episode = dataset.members()[0].read()
    with pytest.raises(InputError, match=r"not on this machine\. Copy"):
        _ = episode.path
    with pytest.raises(UnknownNameError, match=r"No split named .tset..*Did you mean .test."):
        dataset.sequences("tset")
    with pytest.raises(UnknownNameError, match="No camera named 'side'"):
        dataset.sequences(camera="side")
    with pytest.raises(InputError, match="memory://nothing contains no data set"):
        vrcaps.data.open("memory://nothing")
    with pytest.raises(InputError, match="memory://nothing is not an episode"):
        vrcaps.data.sequences_of("memory://nothing")
    open_store(remote).write(f"episodes/{episode.name}/front/rgb/000001.png", b"no image")
    with pytest.raises(InputError, match=r"Cannot read memory://.*000001\.png"):
        episode.image("front", "rgb", 1)
