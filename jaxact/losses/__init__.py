"""Losses: functions of the model's output, a batch and the training's progress."""

from jaxact.losses.a2c import A2C as A2C
from jaxact.losses.advisor import Advisor as Advisor
from jaxact.losses.advisor import AdvisorImitation as AdvisorImitation
from jaxact.losses.base import Anchored as Anchored
from jaxact.losses.base import Batch as Batch
from jaxact.losses.base import Following as Following
from jaxact.losses.base import Loss as Loss
from jaxact.losses.base import Progress as Progress
from jaxact.losses.base import Rewarding as Rewarding
from jaxact.losses.cordial import Cordial as Cordial
from jaxact.losses.cpca import CPCA as CPCA
from jaxact.losses.cpca import CPCASoftmax as CPCASoftmax
from jaxact.losses.curiosity import Curiosity as Curiosity
from jaxact.losses.dqn import DQN as DQN
from jaxact.losses.fusion_entropy import FusionEntropy as FusionEntropy
from jaxact.losses.gail import GAIL as GAIL
from jaxact.losses.imitation import GroupedImitation as GroupedImitation
from jaxact.losses.imitation import Imitation as Imitation
from jaxact.losses.inverse_dynamics import InverseDynamics as InverseDynamics
from jaxact.losses.kl_to_reference import KLToReference as KLToReference
from jaxact.losses.policy_gradient import PolicyGradient as PolicyGradient
from jaxact.losses.ppo import PPO as PPO
from jaxact.losses.pqn import PQN as PQN
from jaxact.losses.random_network import RandomNetworkDistillation as RandomNetworkDistillation
from jaxact.losses.sac import SAC as SAC
from jaxact.losses.sac import Critic as Critic
from jaxact.losses.target import Target as Target
from jaxact.losses.temporal_distance import TemporalDistance as TemporalDistance
from jaxact.losses.vtrace import VTrace as VTrace

__all__ = [
    "A2C",
    "CPCA",
    "DQN",
    "GAIL",
    "PPO",
    "PQN",
    "SAC",
    "Advisor",
    "AdvisorImitation",
    "Anchored",
    "Batch",
    "CPCASoftmax",
    "Cordial",
    "Critic",
    "Curiosity",
    "Following",
    "FusionEntropy",
    "GroupedImitation",
    "Imitation",
    "InverseDynamics",
    "KLToReference",
    "Loss",
    "PolicyGradient",
    "Progress",
    "RandomNetworkDistillation",
    "Rewarding",
    "Target",
    "TemporalDistance",
    "VTrace",
]
