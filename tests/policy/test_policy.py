"""Policies by their names: baselines, import paths, files; and what they ask of an environment."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium import spaces

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.policy.baselines import RandomPolicy
from vrcaps.policy.catalog import BASELINES, read_policy
from vrcaps.policy.policy import Policy, Requirements


@pytest.fixture
def odd_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules whose names lead to no policy."""
    methods = "def reset(self, indices, seeds): ...\n    def act(self, observations, env): ..."
    (tmp_path / "odd_policies.py").write_text(
        "import os\n"
        "def Called(): os.abort()\n"
        f"class Halves:\n    {methods}\n"
        f"class Exits:\n    {methods}\n    def __init__(self): raise SystemExit(3)\n"
    )
    (tmp_path / "odd_syntax.py").write_text("class Mine(:\n")
    (tmp_path / "odd_lazy.py").write_text("def __getattr__(name): raise ImportError('later')\n")
    (tmp_path / "odd_exit.py").write_text("raise SystemExit\n")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_is_a_policy(name: str) -> None:
    assert isinstance(read_policy(name), Policy)


def test_a_policy_of_ones_own_by_its_import_path() -> None:
    assert isinstance(read_policy("vrcaps.policy.baselines:RandomPolicy"), RandomPolicy)


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("centreline-typo", UnknownNameError, "No policy named 'centreline-typo'. Known: .*random"),
        ("no.such.module:Mine", InputError, "No policy at no.such.module:Mine"),
        ("vrcaps.policy.baselines:Mine", InputError, "the module has no 'Mine'"),
        ("pathlib:Path", InputError, "pathlib:Path is not a policy"),
        ("vrcaps.policy.catalog:read_policy", InputError, "is not a policy"),
        ("vrcaps.policy.policy:Policy", InputError, "cannot be made without arguments: TypeError"),
        ("os:abort", InputError, "os:abort is not a policy"),
        ("sys:exit", InputError, "sys:exit is not a policy"),
        ("os:environ", InputError, "os:environ is not a policy"),
        ("subprocess:Popen", InputError, "subprocess:Popen is not a policy"),
        (":Mine", InputError, "No policy at :Mine: ValueError"),
        (".mine:Mine", InputError, "No policy at .mine:Mine: TypeError"),
        ("vrcaps.policy.baselines:", InputError, "the module has no ''"),
        ("odd_policies:Called", InputError, "odd_policies:Called is not a policy"),
        ("odd_policies:Halves", InputError, "odd_policies:Halves is not a policy"),
        ("odd_policies:Exits", InputError, "cannot be made without arguments: SystemExit: 3"),
        ("odd_syntax:Mine", InputError, "No policy at odd_syntax:Mine: SyntaxError: "),
        ("odd_lazy:Mine", InputError, "No policy at odd_lazy:Mine: ImportError: later"),
        ("odd_exit:Mine", InputError, "No policy at odd_exit:Mine: SystemExit"),
    ],
)
def test_what_is_no_policy_is_one_line(
    name: str, error: type[Exception], said: str, odd_modules: None
) -> None:
    """Nothing is called that is not a class with the methods of a policy."""
    with pytest.raises(error, match=said) as caught:
        read_policy(name)
    assert "\n" not in str(caught.value)


def test_a_file_that_holds_no_policy_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "policy.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"policy\.npz"):
        read_policy(tmp_path / "policy.npz")


def test_a_policy_says_what_the_environment_lacks() -> None:
    settings = SimpleNamespace(
        observations=(SimpleNamespace(name="state"),), actuation=SimpleNamespace(kind="wrench")
    )
    Requirements().check(settings, "mine")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="Add map"):
        Requirements(observations=("state", "map")).check(settings, "mine")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="mine acts by magnet or arm"):
        Requirements(actuations=("magnet", "arm")).check(settings, "mine")  # type: ignore[arg-type]


@pytest.mark.parametrize("space", [spaces.Box(-1.0, 1.0, (6,), np.float32), spaces.Discrete(7)])
def test_random_is_the_same_whichever_worlds_run_beside(space: spaces.Space) -> None:
    def actions(seeds: list[int]) -> np.ndarray:
        policy = RandomPolicy()
        settings = SimpleNamespace(actuation=SimpleNamespace(kind="rope"))
        env = SimpleNamespace(num_envs=len(seeds), single_action_space=space, settings=settings)
        policy.reset(np.arange(len(seeds)), seeds)
        return np.stack([policy.act({}, env) for _ in range(8)])  # type: ignore[arg-type]

    both, alone = actions([3, 5]), actions([5])
    assert np.array_equal(both[:, 1], alone[:, 0])
    assert not np.array_equal(both[:, 0], both[:, 1])
    assert all(space.contains(a) for a in both[:, 0])
