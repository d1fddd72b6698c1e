"""Models: linen modules from observations and memory to policy and value."""

from jaxact.models.actor_critic import ActorCritic as ActorCritic
from jaxact.models.agents_actor_critic import AgentsActorCritic as AgentsActorCritic
from jaxact.models.attended_words import BidirectionalWords as BidirectionalWords
from jaxact.models.beliefs import MultipleBeliefs as MultipleBeliefs
from jaxact.models.encoders import BagOfWords as BagOfWords
from jaxact.models.encoders import Concatenated as Concatenated
from jaxact.models.encoders import Embedding as Embedding
from jaxact.models.encoders import FiLM as FiLM
from jaxact.models.encoders import GridCodes as GridCodes
from jaxact.models.encoders import Image as Image
from jaxact.models.encoders import InstructedGrid as InstructedGrid
from jaxact.models.encoders import Vector as Vector
from jaxact.models.encoders import WordsGRU as WordsGRU
from jaxact.models.film_actor_critic import FiLMActorCritic as FiLMActorCritic
from jaxact.models.heads import ActionValueHead as ActionValueHead
from jaxact.models.heads import ActorHead as ActorHead
from jaxact.models.memory import GRU as GRU
from jaxact.models.memory import LSTM as LSTM
from jaxact.models.memory import NoMemory as NoMemory
from jaxact.models.normalized import Normalized as Normalized
from jaxact.models.output import ActorCriticOutput as ActorCriticOutput
from jaxact.models.projected_grid import ProjectedGrid as ProjectedGrid
from jaxact.models.q_network import QNetwork as QNetwork
from jaxact.models.resnet import ResNet as ResNet
from jaxact.models.team_actors import CentralActor as CentralActor
from jaxact.models.team_actors import SyncActor as SyncActor

__all__ = [
    "GRU",
    "LSTM",
    "ActionValueHead",
    "ActorCritic",
    "ActorCriticOutput",
    "ActorHead",
    "AgentsActorCritic",
    "BagOfWords",
    "BidirectionalWords",
    "CentralActor",
    "Concatenated",
    "Embedding",
    "FiLM",
    "FiLMActorCritic",
    "GridCodes",
    "Image",
    "InstructedGrid",
    "MultipleBeliefs",
    "NoMemory",
    "Normalized",
    "ProjectedGrid",
    "QNetwork",
    "ResNet",
    "SyncActor",
    "Vector",
    "WordsGRU",
]
