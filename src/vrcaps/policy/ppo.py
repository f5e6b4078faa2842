"""Proximal policy optimization (Schulman et al. 2017) with Stable-Baselines3, one episode a round.

In a round all worlds run for the time of one episode, from a reset with seeds that follow from
the run's seed and the round's number; then the policy is improved. So between rounds the policy,
its optimizer and the normalizer are all there is, and a run goes on from them to the same bytes.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps import rng
from vrcaps.env.settings import EnvSettings
from vrcaps.errors import MissingExtraError, import_extra, require
from vrcaps.limits import Range, check_fields
from vrcaps.policy.mlp_policy import MlpPolicy, Normalizer, kept_settings

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.running_mean_std import RunningMeanStd

_COUNT = Range(least=1)
_SHARE = Range(least=0.0, most=1.0)


@dataclass(frozen=True)
class PpoSettings:
    """How a policy is learned.

    Attributes:
        num_envs: Worlds side by side.
        num_actions: Actions in all worlds together after which training ends, rounded up to whole
            rounds.
        updates: How often the policy is improved in a round; more learn sooner from less.
        hidden: Neurons of each layer, of the policy and of its value function alike.
        batch: Actions in a minibatch.
        epochs: Times that each action is learned from.
        learning_rate: Of Adam.
        is_annealed: Whether the learning rate falls to a tenth until the end, in equal steps.
        gamma: Discount of a reward from action to action.
        gae_lambda: λ of generalized advantage estimation.
        clip: Largest relative change of an action's probability that is rewarded.
        entropy: Weight of the entropy's bonus.
        initial_std: Standard deviation of continuous actions at first.
        is_normalized: Whether observations and rewards are divided by their spread so far.
        evaluate_every: Rounds between evaluations; 0 for none.
        evaluation_episodes: Episodes of an evaluation, always the same.
    """

    num_envs: Annotated[int, _COUNT] = 32
    num_actions: Annotated[int, _COUNT] = 1_000_000
    updates: Annotated[int, _COUNT] = 2
    hidden: tuple[int, ...] = (256, 256)
    batch: Annotated[int, _COUNT] = 2048
    epochs: Annotated[int, _COUNT] = 8
    learning_rate: Annotated[float, Range(above=0.0, most=1.0)] = 3e-4
    is_annealed: bool = True
    gamma: Annotated[float, _SHARE] = 0.99
    gae_lambda: Annotated[float, _SHARE] = 0.95
    clip: Annotated[float, Range(above=0.0, most=1.0)] = 0.2
    entropy: Annotated[float, Range(least=0.0)] = 1e-3
    initial_std: Annotated[float, Range(above=0.0, most=2.0)] = 0.6
    is_normalized: bool = True
    evaluate_every: Annotated[int, Range(least=0)] = 5
    evaluation_episodes: Annotated[int, _COUNT] = 8

    def __post_init__(self) -> None:
        check_fields(self)
        allowed = "1 or more layers of 1 or more neurons"
        require(bool(self.hidden) and min(self.hidden) >= 1, "hidden", self.hidden, allowed)


class Ppo:
    """A policy in the making.

    Attributes:
        num_rounds: Rounds until `num_actions` are done.
    """

    def __init__(self, env: EnvSettings, settings: PpoSettings, seed: int) -> None:
        """Makes worlds and a policy that has learned nothing.

        Raises:
            MissingExtraError: If Stable-Baselines3 is not installed.
        """
        require_learner()
        from stable_baselines3.common.utils import set_random_seed
        from stable_baselines3.common.vec_env import VecNormalize

        from vrcaps.env.sb3 import Sb3VecEnv

        self.settings, self.env_settings, self.seed = settings, env, seed
        steps = max(round(env.episode_time / env.control_period), 1)
        self.steps = -(-steps // settings.updates)
        self.actions_per_round = self.steps * settings.updates * settings.num_envs
        self.learning_rate = settings.learning_rate
        self.num_rounds = -(-settings.num_actions // self.actions_per_round)
        normalized = settings.is_normalized
        self.envs = VecNormalize(
            Sb3VecEnv(env, settings.num_envs, is_flat=True),
            norm_obs=normalized,
            norm_reward=normalized,
            gamma=settings.gamma,
        )
        set_random_seed(_seed(seed, "start", 0))
        self.model = _model(self)
        from stable_baselines3.common.logger import Logger

        self.model.set_logger(Logger(None, []))

    def run_round(self, number: int) -> dict[str, float]:
        """Play an episode in every world and learn from it.

        Args:
            number: Of the round, from 0; its randomness follows from it.

        Returns:
            What the round was like.
        """
        from stable_baselines3.common.utils import set_random_seed

        seed = _seed(self.seed, "round", number)
        set_random_seed(seed)
        self.envs.seed(seed)
        self.model.set_env(self.envs)  # lets the next call reset the worlds
        self.model.num_timesteps = number * self.actions_per_round
        if self.settings.is_annealed:
            share = max(1.0 - number / self.num_rounds, 0.1)
            self.learning_rate = share * self.settings.learning_rate
        watch = _watch(self.settings.num_envs)
        self.model.learn(
            self.actions_per_round,
            callback=watch,
            reset_num_timesteps=False,
        )
        logged = self.model.logger.name_to_value
        return {**watch.means(), **{n: float(logged.get(k, np.nan)) for n, k in _LOGGED.items()}}

    def policy(self) -> MlpPolicy:
        """What was learned so far."""
        net: Any = self.model.policy
        chain = [*net.mlp_extractor.policy_net, net.action_net]
        layers = [
            (m.weight.detach().numpy().copy(), m.bias.detach().numpy().copy())
            for m in chain
            if hasattr(m, "weight")
        ]
        size = layers[0][0].shape[1]
        normalizer = Normalizer(np.zeros(size), np.ones(size) - 1e-8, np.inf)
        if self.settings.is_normalized:
            rms = self.envs.obs_rms
            normalizer = Normalizer(rms.mean.copy(), rms.var.copy(), self.envs.clip_obs)  # type: ignore[union-attr]
        return MlpPolicy(layers, normalizer, kept_settings(self.env_settings))

    def state(self) -> dict[str, np.ndarray]:
        """All that a later round depends on."""
        net = self.model.policy
        arrays = {f"policy/{k}": v.numpy().copy() for k, v in net.state_dict().items()}
        for number, moments in net.optimizer.state_dict()["state"].items():
            for name, value in moments.items():
                arrays[f"optimizer/{number}/{name}"] = value.numpy().copy()
        for name, rms in self._spreads():
            arrays |= {f"{name}/{k}": np.asarray(getattr(rms, k)).copy() for k in _SPREAD}
        return arrays

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Puts back what `state` gave."""
        import torch

        net, optimizer = self.model.policy, self.model.policy.optimizer
        tensors = {k: torch.from_numpy(v.copy()) for k, v in arrays.items() if v.dtype.kind == "f"}
        net.load_state_dict(_below(tensors, "policy/"))
        moments: dict[int, dict[str, Any]] = {}
        for name, tensor in _below(tensors, "optimizer/").items():
            number, key = name.split("/")
            moments.setdefault(int(number), {})[key] = tensor
        optimizer.load_state_dict({**optimizer.state_dict(), "state": moments})
        for name, rms in self._spreads():
            for key in _SPREAD:
                value = arrays[f"{name}/{key}"]
                setattr(rms, key, float(value) if key == "count" else value.copy())

    def log_to(self, folder: Path) -> None:
        """Write what the rounds are like for TensorBoard, too.

        Raises:
            MissingExtraError: If TensorBoard is not installed.
        """
        from stable_baselines3.common.logger import configure

        try:
            self.model.set_logger(configure(str(folder), ["tensorboard"]))
        except (ImportError, AssertionError) as error:
            raise MissingExtraError("tensorboard", "learn") from error

    def close(self) -> None:
        """Lets go of the worlds."""
        self.envs.close()

    def _spreads(self) -> list[tuple[str, RunningMeanStd]]:
        if not self.settings.is_normalized:
            return []
        return [("observations", self.envs.obs_rms), ("rewards", self.envs.ret_rms)]  # type: ignore[list-item]


_SPREAD = ("mean", "var", "count")
_LOGGED = {
    "entropy": "train/entropy_loss",
    "kl": "train/approx_kl",
    "explained_variance": "train/explained_variance",
}


def require_learner() -> None:
    """Check that what learns is installed.

    Raises:
        MissingExtraError: If it is not.
    """
    import_extra("stable_baselines3", "learn", package="stable-baselines3")


def _seed(seed: int, purpose: str, number: int) -> int:
    return int(rng.stream(seed, f"policy/ppo/{purpose}", number).integers(2**31))


def _below(tensors: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _model(ppo: Ppo) -> PPO:
    """Stable-Baselines3's PPO with the settings."""
    from stable_baselines3 import PPO

    s = ppo.settings
    kwargs: dict[str, Any] = {"net_arch": list(s.hidden)}
    if hasattr(ppo.envs.action_space, "low"):
        kwargs["log_std_init"] = float(np.log(s.initial_std))
    with warnings.catch_warnings():
        # The last minibatch may be smaller than the others.
        warnings.filterwarnings("ignore", message=".*truncated mini-batch", category=UserWarning)
        return PPO(
            "MlpPolicy",
            ppo.envs,
            learning_rate=lambda _: ppo.learning_rate,
            n_steps=ppo.steps,
            batch_size=min(s.batch, ppo.steps * s.num_envs),
            n_epochs=s.epochs,
            gamma=s.gamma,
            gae_lambda=s.gae_lambda,
            clip_range=s.clip,
            ent_coef=s.entropy,
            policy_kwargs=kwargs,
            device="cpu",
        )


def _watch(num_envs: int) -> Any:
    """A callback that keeps what episodes of a round were like."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Watch(BaseCallback):
        def __init__(self) -> None:
            super().__init__()
            self.rows: list[dict[str, Any]] = []

        def _on_step(self) -> bool:
            ends = self.locals["dones"]
            self.rows += [self.locals["infos"][k] for k in np.flatnonzero(ends)]
            return True

        def means(self) -> dict[str, float]:
            numbers = {
                name: float(np.mean([row[name] for row in self.rows if name in row]))
                for name, value in (self.rows[0] if self.rows else {}).items()
                if isinstance(value, float | np.floating | np.bool_)
            }
            return {"num_episodes": float(len(self.rows)), **numbers}

    return Watch()
