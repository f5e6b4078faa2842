"""Proximal policy optimization (Schulman et al. 2017) with Stable-Baselines3, in rounds.

In a round all worlds run for the duration of one episode, from a reset with seeds that follow from
the run's seed and the round's index; then the policy is updated. The state between rounds therefore
consists of the policy, its optimizer and the normalizer, from which a run resumes byte for byte.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import MissingExtraError, import_extra, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.env.settings import EnvSettings
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.mlp_policy import MlpPolicy, Normalizer, kept_settings

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.running_mean_std import RunningMeanStd

    from vrcaps.policy.policy import Policy

_COUNT = Range(min=1)
_SHARE = Range(min=0.0, max=1.0)


@dataclass(frozen=True)
class PpoSettings:
    """Hyperparameters of PPO.

    Attributes:
        num_envs: Number of parallel worlds.
        num_actions: Total number of actions in all worlds, rounded up to whole rounds.
        updates: Number of policy updates per round; more updates train faster on less data each.
        hidden: Neurons of each hidden layer, of both the policy and its value function.
        batch: Actions in a minibatch.
        epochs: Number of passes over the collected actions per update.
        learning_rate: Learning rate of Adam.
        is_annealed: Whether the learning rate decreases to a tenth by the end, linearly.
        gamma: Discount factor of rewards per action.
        gae_lambda: λ of generalized advantage estimation.
        clip: Clipping range of the probability ratio.
        entropy: Weight of the entropy bonus.
        initial_std: Initial standard deviation of continuous actions.
        is_normalized: Whether observations and rewards are normalized by their running statistics.
        evaluate_every: Rounds between evaluations; 0 for none.
        evaluation_episodes: Number of episodes of an evaluation, always the same ones.
        teacher: Policy that is imitated before the first round, see `imitate`; it must act by
            observations. Empty for none.
        teacher_rounds: Number of rounds of its demonstrations.
    """

    num_envs: Annotated[int, _COUNT] = 32
    num_actions: Annotated[int, _COUNT] = 1_000_000
    updates: Annotated[int, _COUNT] = 2
    hidden: tuple[int, ...] = (256, 256)
    batch: Annotated[int, _COUNT] = 2048
    epochs: Annotated[int, _COUNT] = 8
    learning_rate: Annotated[float, Range(above=0.0, max=1.0)] = 3e-4
    is_annealed: bool = True
    gamma: Annotated[float, _SHARE] = 0.99
    gae_lambda: Annotated[float, _SHARE] = 0.95
    clip: Annotated[float, Range(above=0.0, max=1.0)] = 0.2
    entropy: Annotated[float, Range(min=0.0)] = 1e-3
    initial_std: Annotated[float, Range(above=0.0, max=2.0)] = 0.6
    is_normalized: bool = True
    evaluate_every: Annotated[int, Range(min=0)] = 5
    evaluation_episodes: Annotated[int, _COUNT] = 8
    teacher: str = ""
    teacher_rounds: Annotated[int, _COUNT] = 3

    def __post_init__(self) -> None:
        check_fields(self)
        allowed = "1 or more layers of 1 or more neurons"
        require(len(self.hidden) > 0 and min(self.hidden) >= 1, "hidden", self.hidden, allowed)


class Ppo:
    """PPO training of a policy.

    Attributes:
        num_rounds: Number of rounds for `num_actions`.
    """

    def __init__(self, env: EnvSettings, settings: PpoSettings, seed: int) -> None:
        """Create the worlds and an untrained policy.

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

    def run_round(self, index: int) -> dict[str, float]:
        """Run an episode in every world and update the policy.

        Args:
            index: Index of the round, from 0; it determines the randomness.

        Returns:
            Statistics of the round.
        """
        from stable_baselines3.common.utils import set_random_seed

        seed = _seed(self.seed, "round", index)
        set_random_seed(seed)
        self.envs.seed(seed)
        self.model.set_env(self.envs)  # lets the next call reset the worlds
        self.model.num_timesteps = index * self.actions_per_round
        if self.settings.is_annealed:
            fraction = max(1.0 - index / self.num_rounds, 0.1)
            self.learning_rate = fraction * self.settings.learning_rate
        watch = _watch(self.settings.num_envs)
        self.model.learn(
            self.actions_per_round,
            callback=watch,
            reset_num_timesteps=False,
        )
        logged = self.model.logger.name_to_value
        return {**watch.means(), **{n: float(logged.get(k, np.nan)) for n, k in _LOGGED.items()}}

    def policy(self) -> MlpPolicy:
        """Return the current policy."""
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
        """State on which later rounds depend."""
        net = self.model.policy
        arrays = {f"policy/{k}": v.numpy().copy() for k, v in net.state_dict().items()}
        for number, moments in net.optimizer.state_dict()["state"].items():
            for name, value in moments.items():
                arrays[f"optimizer/{number}/{name}"] = value.numpy().copy()
        for name, rms in self._spreads():
            arrays |= {f"{name}/{k}": np.asarray(getattr(rms, k)).copy() for k in _SPREAD}
        return arrays

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore a state from `state`."""
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
        """Log the statistics of rounds to TensorBoard as well.

        Raises:
            MissingExtraError: If TensorBoard is not installed.
        """
        from stable_baselines3.common.logger import configure

        try:
            self.model.set_logger(configure(str(folder), ["tensorboard"]))
        except (ImportError, AssertionError) as error:
            raise MissingExtraError("tensorboard", "learn") from error

    def close(self) -> None:
        """Close the worlds."""
        self.envs.close()

    def _spreads(self) -> list[tuple[str, RunningMeanStd]]:
        if not self.settings.is_normalized:
            return []
        return [("observations", self.envs.obs_rms), ("rewards", self.envs.ret_rms)]  # type: ignore[list-item]


_IMITATION_EPOCHS, _IMITATION_RATE = 30, 1e-3


def imitate(learner: Ppo, teacher: Policy) -> dict[str, float]:
    """Fit a learner's policy to the actions of a teacher by least squares.

    Aggregates data (DAgger: Ross, Gordon, Bagnell, AISTATS 2011): in the first round the teacher
    acts in an episode of every world, in later ones the learner does. The teacher's actions are the
    targets for all observations so far. The teacher's own observations are added to the worlds.

    Args:
        learner: Untrained learner with continuous actions.
        teacher: Policy to imitate.

    Returns:
        Mean square of the actions' error, and the mean square of the actions, after the last round.

    Raises:
        InputError: If the teacher does not fit the actuation or the learner's observations.
    """
    env, s = learner.env_settings, learner.settings
    envs = CapsuleVectorEnv(taught_settings(env, teacher, s.teacher), s.num_envs)
    data: list[tuple[np.ndarray, np.ndarray]] = []
    errors = {}
    for index in range(s.teacher_rounds):
        seeds = [_seed(learner.seed, f"teacher/{index}", k) for k in range(s.num_envs)]
        data += _demonstrations(learner, teacher, envs, seeds, is_led=index == 0)
        errors = _fit(learner, *(np.concatenate(part) for part in zip(*data, strict=True)))
    envs.close()
    return errors


def taught_settings(env: EnvSettings, teacher: Policy, name: str) -> EnvSettings:
    """Settings of an environment with the observations of the named teacher added.

    Raises:
        InputError: If the teacher does not fit the actuation or the observations.
    """
    own = {observation.name for observation in env.observations}
    wanted = teacher.requires.settings.get("observations", ())
    others = tuple(o for o in wanted if o.name not in own)
    settings = replace(env, observations=(*env.observations, *others))
    teacher.requires.check(settings, name)
    return settings


def _demonstrations(
    learner: Ppo, teacher: Policy, envs: CapsuleVectorEnv, seeds: list[int], *, is_led: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Observations and the teacher's actions of an episode of every world."""
    from vrcaps.env.sb3 import flat_observations

    observations, _ = envs.reset(seed=seeds)
    teacher.reset(np.arange(envs.num_envs), seeds)
    policy, rows = learner.policy(), []
    over = np.zeros(envs.num_envs, bool)
    for _ in range(learner.steps * learner.settings.updates):
        wanted = teacher.act(observations, envs)
        own = {o.name: observations[o.name] for o in learner.env_settings.observations}
        flat = flat_observations(own, envs.num_envs)
        rows.append((flat[~over], wanted[~over]))
        acted = wanted if is_led else policy.act(observations, envs)
        observations, _, terminated, truncated, _ = envs.step(acted)
        if over.any():  # these worlds have started an episode in this step
            started = np.flatnonzero(over)
            teacher.reset(started, [seeds[k] + 1 for k in started])
        over = terminated | truncated
    return rows


def _fit(learner: Ppo, inputs: np.ndarray, targets: np.ndarray) -> dict[str, float]:
    """Fit the policy's mean to targets; returns mean squares of error and target."""
    import torch

    net: Any = learner.model.policy
    if learner.settings.is_normalized:
        rms: Any = learner.envs.obs_rms
        rms.mean, rms.var = inputs.mean(axis=0), inputs.var(axis=0)
        rms.count = float(len(inputs))
        inputs = np.asarray(learner.envs.normalize_obs(inputs))
    x, y = torch.from_numpy(inputs.astype(np.float32)), torch.from_numpy(targets)
    chain = torch.nn.Sequential(net.mlp_extractor.policy_net, net.action_net)
    optimizer = torch.optim.Adam(chain.parameters(), _IMITATION_RATE)
    batch = min(learner.settings.batch, 512)
    for _ in range(_IMITATION_EPOCHS):
        for some in torch.randperm(len(x)).split(batch):
            optimizer.zero_grad()
            torch.nn.functional.mse_loss(chain(x[some]), y[some]).backward()
            optimizer.step()
    with torch.no_grad():
        error = float(torch.nn.functional.mse_loss(chain(x), y))
    return {"imitation_error": error, "imitation_scale": float((y**2).mean())}


_SPREAD = ("mean", "var", "count")
_LOGGED = {
    "entropy": "train/entropy_loss",
    "kl": "train/approx_kl",
    "explained_variance": "train/explained_variance",
}


def require_learner() -> None:
    """Check that Stable-Baselines3 is installed.

    Raises:
        MissingExtraError: If it is not.
    """
    import_extra("stable_baselines3", "learn", package="stable-baselines3")


def _seed(seed: int, purpose: str, index: int) -> int:
    return int(rng.stream(seed, f"policy/ppo/{purpose}", index).integers(2**31))


def _below(tensors: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _model(ppo: Ppo) -> PPO:
    """Create Stable-Baselines3's PPO from the settings."""
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
    """Create a callback that records the episodes of a round."""
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
            means = {
                name: float(np.mean([row[name] for row in self.rows if name in row]))
                for name, value in (self.rows[0] if self.rows else {}).items()
                if isinstance(value, float | np.floating | np.bool_)
            }
            return {"num_episodes": float(len(self.rows)), **means}

    return Watch()
