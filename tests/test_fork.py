"""Forked processes: the core works in them and gives the bytes of the parent."""

import hashlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.small_envs import small_env
from tests.support.tubes import straight_gut, textured
from tests.support.waiting import WATCHDOG
from vrcaps import _core
from vrcaps.camera.derive import scaled_camera
from vrcaps.capsule.device_file import read_device
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.build import build
from vrcaps.scenario.scenario import Scenario
from vrcaps.world.control import Control
from vrcaps.world.model import Model
from vrcaps.world.world import World

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows does not fork"),
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),
]

DEVICE = read_device("mirocam")
MODEL = Model(
    textured(straight_gut({"colon": 0.12}, radius=0.015, edge=4e-3)),
    replace(DEVICE, cameras=(scaled_camera(DEVICE.cameras[0], 0.3),)),
)
RENDERER = Renderer(MODEL)


def _digest(*arrays: Any) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _in_child(work: Callable[[], Any]) -> Any:
    """The result of work in a forked process, or the text of its error."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(int(WATCHDOG))
        try:
            answer = work()
        except BaseException as error:
            answer = repr(error)
        with os.fdopen(sender, "wb") as file:
            pickle.dump(answer, file)
        os._exit(0)
    os.close(sender)
    with os.fdopen(receiver, "rb") as file:
        answer = file.read()
    status = os.waitpid(child, 0)[1]
    assert answer, f"The child ended with status {status}."
    return pickle.loads(answer)


def _frame(renderer: Renderer = RENDERER) -> str:
    frame = renderer.render(MODEL.place(0.05), "front", channels=("rgb", "depth", "label"))
    return _digest(frame.rgb, frame.depth, frame.label)


def _stepped() -> str:
    world = World(MODEL)
    for _ in range(2):
        world.step(Control(force_world=(0.0, 0.0, 0.02)), 2e-3)
    return _digest(world.T_world_capsule, world.snapshot().wall_displacement)


def _episode() -> str:
    env = small_env(num_points=64)
    return _digest(*env.step(np.zeros(env.action_space.shape))[0].values())


def _built() -> str:
    model, _ = build(Scenario(organ=MODEL.organ, capsule=MODEL.device))
    return _digest(model.organ.vertices, model.wall.vertex_normals())


@pytest.mark.parametrize("work", [_frame, _stepped, _episode, _built])
def test_a_child_gives_the_bytes_of_its_parent(work: Callable[[], str]) -> None:
    assert _in_child(work) == work() == _in_child(work)


def test_a_child_of_a_child_gives_them_too() -> None:
    assert _in_child(lambda: (_frame(), _in_child(_frame))) == (_frame(), _frame())


def test_a_child_of_another_thread_gives_them_too() -> None:
    answers: list[str] = []
    thread = threading.Thread(target=lambda: answers.append(_in_child(_frame)))
    thread.start()
    thread.join()
    assert answers == [_frame()]


def test_a_child_starts_as_many_threads_as_its_environment_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def threads() -> tuple[int, int]:
        _frame()
        tasks = Path("/proc/self/task")
        names = [(task / "comm").read_text() for task in tasks.iterdir()] if tasks.is_dir() else []
        return _core.num_threads(), sum(name.startswith("vrcaps-") for name in names)

    monkeypatch.setenv("RAYON_NUM_THREADS", "3")
    started = 3 if sys.platform == "linux" else 0
    assert _in_child(threads) == (3, started)


@pytest.fixture
def rendering() -> Iterator[Renderer]:
    """A renderer that another thread uses all the time."""
    renderer, ended = Renderer(MODEL), threading.Event()

    def loop() -> None:
        while not ended.is_set():
            _frame(renderer)

    thread = threading.Thread(target=loop)
    thread.start()
    yield renderer
    ended.set()
    thread.join()


@pytest.mark.slow
def test_a_fork_while_another_thread_is_in_the_core_does_not_hang(rendering: Renderer) -> None:
    """Not even where the child uses what the other thread was using, or the same caches."""
    expected = _frame()
    for _ in range(10):
        assert _in_child(lambda: (_frame(), _frame(rendering))) == (expected, expected)


@pytest.mark.slow
def test_forked_workers_of_a_data_loader_give_the_frames_of_the_parent() -> None:
    data = pytest.importorskip("torch.utils.data")
    places = np.linspace(0.03, 0.09, 8)

    class Frames(data.Dataset):
        def __len__(self) -> int:
            return len(places)

        def __getitem__(self, number: int) -> np.ndarray:
            return RENDERER.render(MODEL.place(places[number]), "front", channels=("rgb",)).rgb

    frames = Frames()
    expected = [frames[k] for k in range(len(places))]
    loader = data.DataLoader(
        frames, None, num_workers=4, multiprocessing_context="fork", timeout=WATCHDOG
    )
    for given, own in zip(loader, expected, strict=True):
        np.testing.assert_array_equal(given, own)


def _frame_of(number: int) -> str:
    return _frame()


def test_a_pool_of_forked_processes_gives_them_too() -> None:
    expected = _frame()
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(_frame_of, range(4)).get(WATCHDOG) == [expected] * 4


@pytest.mark.slow
def test_a_child_denoises() -> None:
    pytest.importorskip("pyoidn")
    settings = RenderSettings(light="path", spp=1, max_bounces=1, denoise=True)
    renderer = Renderer(MODEL, settings)
    assert _in_child(lambda: _frame(renderer)) == _frame(renderer)
    assert _in_child(lambda: _frame(renderer)) == _frame(renderer)
