"""Losses: functions of the model's output, a batch and the training's progress."""

from jaxact.losses.a2c import A2C as A2C
from jaxact.losses.advisor import Advisor as Advisor
from jaxact.losses.advisor import AdvisorImitation as AdvisorImitation
from jaxact.losses.base import Batch as Batch
from jaxact.losses.base import Loss as Loss
from jaxact.losses.base import Progress as Progress
from jaxact.losses.base import Rewarding as Rewarding
from jaxact.losses.imitation import GroupedImitation as GroupedImitation
from jaxact.losses.imitation import Imitation as Imitation
from jaxact.losses.policy_gradient import PolicyGradient as PolicyGradient
from jaxact.losses.ppo import PPO as PPO

__all__ = [
    "A2C",
    "PPO",
    "Advisor",
    "AdvisorImitation",
    "Batch",
    "GroupedImitation",
    "Imitation",
    "Loss",
    "PolicyGradient",
    "Progress",
    "Rewarding",
]
