"""Losses: functions of the model's output, a batch and the training's progress."""

from jaxact.losses.a2c import A2C as A2C
from jaxact.losses.base import Batch as Batch
from jaxact.losses.base import Loss as Loss
from jaxact.losses.base import Progress as Progress
from jaxact.losses.imitation import Imitation as Imitation
from jaxact.losses.ppo import PPO as PPO

__all__ = ["A2C", "PPO", "Batch", "Imitation", "Loss", "Progress"]
