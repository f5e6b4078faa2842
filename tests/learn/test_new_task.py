"""The task that docs/concepts/learning.md adds, run as it stands there."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.small_frames import small_sequence
from vrcaps.core.errors import InputError
from vrcaps.learn import TASKS, Backbone, predict, read_weights, samples_of, settings_of, train
from vrcaps.learn.settings import read_settings
from vrcaps.learn.training import BEST
from vrcaps.training import ComputeSettings

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "learning.md"


@pytest.fixture
def task(monkeypatch):
    """The task of the section, registered during the test."""
    text = PAGE.read_text(encoding="utf-8")
    section = re.search(r"^## Your own task\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert section is not None
    monkeypatch.setattr(TASKS, "_added", {})
    names = {"__name__": __name__}
    for code in re.findall(r"```python\n(.*?)```", section[1], re.DOTALL):
        exec(code, names)
    return names["GlareTask"](Backbone(32, "test_resnet"))


def test_it_is_registered_with_its_settings(task):
    assert TASKS["glare"] is type(task)
    assert TASKS.summary("glare") == "Saturated pixels of an image."
    settings = settings_of(task, "ci", ["runs/a"], changes=[("task.backbone.size", 96)])
    assert settings.task == replace(task, backbone=Backbone(96, "test_resnet"))
    with pytest.raises(InputError, match="exists already"):
        TASKS.register(type("Other", (type(task),), {"__module__": "other"}))
    plain = {"task": {"kind": "glare", "backbone": {"size": 64}}}
    assert read_settings(plain, "settings").task.backbone == Backbone(64)


@pytest.mark.slow
def test_it_trains_and_predicts(task, tmp_path):
    pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")
    sequence = small_sequence()
    samples = samples_of(task, [sequence])
    changes = [("steps", 2), ("batch", 2), ("evaluate_every", 2)]
    settings = settings_of(task, "default", ["runs/a"], "scratch", changes)
    progress = train(settings, samples, samples, tmp_path / "run", compute=ComputeSettings("cpu"))
    assert 0.0 <= progress.rows[-1]["accuracy"] <= 1.0
    trained = read_weights(tmp_path / "run" / BEST, task="glare")
    assert trained.task == task
    assert not predict(trained, (sequence,), tmp_path / "out")
    assert (tmp_path / "out" / "sheet.png").is_file()
    assert np.isfinite(progress.best)
