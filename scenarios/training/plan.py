"""What a policy is trained in and by: the task, and the settings of the learner, without any learning framework.

Everything here was chosen on seeds from 100 on. A decision holds for four control steps, 80 ms: the axles answer within
150 ms, and an estimate comes every 100 ms, so that decisions meet it at every age. What follows a decision counts for
2 s. Rewards fall with the distance from the path itself, not with its square: the last centimetres still count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

from scenarios.environments import rewards
from scenarios.environments.domain import Domain
from scenarios.environments.rewards import Reward

ENVIRONMENT: Final = "TrailerSteering-v0"
ACTION_REPEAT: Final = 4
REWARD: Final[Mapping[Reward, float]] = {rewards.off_path: 1.0, rewards.outside_path: 0.1, rewards.steer_effort: 0.02}
REWARD_SCALE: Final = 0.1  # values are of the size of 1 then: half a metre for two seconds is -5
COURSES: Final = ("roundabout", "roundabout-right", "turn-90", *(f"random-{k}" for k in range(1, 17)))
DOMAIN: Final = Domain(friction=(0.3, 0.9), speed=(1.4, 5.0))

# Features by the beginning of their names: usual value and usual deviation from it. Fixed, not running, statistics: the
# trailer's left is its right mirrored, and what hardly ever changes, as ``usable``, must not be blown up.
_USUAL: Final = {
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
    """Of proximal policy optimisation, as stable-baselines3 names them."""

    n_steps: int = 32  # decisions of every environment between updates: 2.6 s
    batch_size: int = 2048
    n_epochs: int = 10
    gamma: float = 0.96  # of a decision: 2 s
    gae_lambda: float = 0.9
    learning_rate: float = 1e-3  # falls to a tenth, linearly
    clip_range: float = 0.2
    target_kl: float = 0.04
    layers: tuple[int, ...] = (64, 64)  # of tanh units, of policy and value function each


SETTINGS: Final = Settings()
LAST_LEARNING_RATE: Final = 0.1  # over the first
EXPLORATION: Final = (0.3, 0.05)  # standard deviation of the actions, first and last: as planned, not as learnt


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What decides the outcome of a training, beside how long it lasts."""

    observation: str = "surrogate"
    vehicle: str = "uk_longer_semitrailer"
    envs: int = 512
    seed: int = 1

    def environment(self) -> dict[str, Any]:
        """Options of the environments that are learnt in."""
        return {
            "observation": self.observation,
            "vehicle": self.vehicle,
            "courses": COURSES,
            "domain": DOMAIN,
            "reward": REWARD,
            "action_repeat": ACTION_REPEAT,
        }

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it, with what is fixed in this version."""
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


def usual(feature: str) -> tuple[float, float]:
    """Usual value of a feature, and usual deviation from it."""
    return next(numbers for start, numbers in _USUAL.items() if feature.startswith(start))
