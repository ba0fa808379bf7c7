"""Training plan of a policy: the task and the settings of the learner, independent of the learning framework.

These settings were chosen on seeds from 100 on. An action is held for four control steps, 80 ms: the axles respond
within 150 ms, and estimates come every 100 ms, so actions see estimates of every age. The horizon of the discount is
2 s. Rewards fall linearly with the distance from the path, not with its square, so that the last centimetres count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

from offtrack.environments import rewards
from offtrack.environments.domain import Domain
from offtrack.environments.rewards import Reward

ENVIRONMENT: Final = "TrailerSteering-v0"
ACTION_REPEAT: Final = 4
REWARD: Final[Mapping[Reward, float]] = {rewards.off_path: 1.0, rewards.outside_path: 0.1, rewards.steer_effort: 0.02}
REWARD_SCALE: Final = 0.1  # gives values of the order of 1: half a metre for two seconds is -5
COURSES: Final = ("roundabout", "roundabout-right", "turn-90", *(f"random-{k}" for k in range(1, 17)))
DOMAIN: Final = Domain(friction=(0.3, 0.9), speed=(1.4, 5.0))

# Mean and standard deviation of features, by the prefix of their names. They are fixed instead of running statistics:
# left and right stay symmetric, and nearly constant features such as ``usable`` are not amplified.
_NORMALISATION: Final = {
    "off_tracking": (0.0, 0.5),
    "path_direction": (0.0, 0.25),
    "path_": (0.0, 1.0),
    "hitch_v_x": (3.5, 1.5),
    "hitch_v_y": (0.0, 1.0),
    "trailer_yaw_rate": (0.0, 0.15),
    "age": (0.14, 0.1),
    "usable": (1.0, 1.0),
    "steer_": (0.0, 0.2),
    "speed": (3.5, 1.5),
    "articulation_": (0.0, 0.3),
    "yaw_rate_": (0.0, 0.15),
    "follow_distance": (13.3, 0.8),
}


class Settings(NamedTuple):
    """Settings of proximal policy optimisation, with the names of stable-baselines3."""

    n_steps: int = 32  # actions of every environment between updates: 2.6 s
    batch_size: int = 2048
    n_epochs: int = 10
    gamma: float = 0.96  # per action: a horizon of 2 s
    gae_lambda: float = 0.9
    learning_rate: float = 1e-3  # falls linearly to a tenth
    clip_range: float = 0.2
    target_kl: float = 0.04
    layers: tuple[int, ...] = (64, 64)  # tanh units of both policy and value function


SETTINGS: Final = Settings()
LAST_LEARNING_RATE: Final = 0.1  # final over initial learning rate
EXPLORATION: Final = (0.3, 0.05)  # standard deviation of the actions at start and end; scheduled, not learnt


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Parameters that determine a training, apart from its length."""

    observation: str = "surrogate"
    vehicle: str = "uk_longer_semitrailer"
    envs: int = 512
    seed: int = 1

    def environment(self) -> dict[str, Any]:
        """Options of the training environments."""
        return {
            "observation": self.observation,
            "vehicle": self.vehicle,
            "courses": COURSES,
            "domain": DOMAIN,
            "reward": REWARD,
            "action_repeat": ACTION_REPEAT,
        }

    def plain(self) -> dict[str, Any]:
        """The plan for JSON, including the fixed settings of this version."""
        return {
            **asdict(self),
            "environment": ENVIRONMENT,
            "action_repeat": ACTION_REPEAT,
            "reward": {part.__name__: weight for part, weight in REWARD.items()},
            "courses": list(COURSES),
            "domain": {name: list(limits) for name, limits in asdict(DOMAIN).items()},
            "ppo": {**SETTINGS._asdict(), "layers": list(SETTINGS.layers)},
            "last_learning_rate": LAST_LEARNING_RATE,
            "exploration": list(EXPLORATION),
        }


def normalisation(feature: str) -> tuple[float, float]:
    """Mean and standard deviation that normalise a feature."""
    return next(numbers for start, numbers in _NORMALISATION.items() if feature.startswith(start))
