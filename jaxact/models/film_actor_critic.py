"""BabyAI's large actor-critic: what to read of the instruction depends on what is remembered."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.models.attended_words import BidirectionalWords, attend
from jaxact.models.convolution import Convolution
from jaxact.models.encoders import RELU, FiLM
from jaxact.models.heads import ActorHead, check_one_agent
from jaxact.models.memory import LSTM
from jaxact.models.output import ActorCriticOutput
from jaxact.spaces import Space

Memory = tuple[jax.Array, jax.Array]


class FiLMActorCritic(nn.Module):
    """A grid view modulated by those words of the instruction that the memory asks for.

    The large model of BabyAI (Chevalier-Boisvert et al. 2019, https://arxiv.org/abs/1810.08272; in
    its code `expert_filmcnn` and `attgru`), as AllenAct trains it on GoToLocal. Two convolutions
    with pooling lead from the view to a map of features. A query made of the LSTM's memory before
    the step attends to the words as a bidirectional GRU reads them; what was attended to modulates
    the map in blocks of two convolutions and `FiLM`. Maxima of 2 × 2 places (for a view of 7 × 7
    there are no more) go into the LSTM, and perceptrons of one hidden layer make policy and value
    of its output.

    What does not depend on the memory is computed for all steps at once: the words, the view's
    convolutions, and those of the first block. The rest is scanned over time; convolutions there
    are on so few places that they are matrix products, and cost little beside the LSTM's.

    Differences from BabyAI's code: features are normalised by groups of channels (Wu & He 2018),
    as embodied AI has done since DD-PPO (Wijmans et al. 2020), and not over the batch, by which a
    lane's policy would depend on its neighbours and differ between acting and learning. For the
    same reason each block is normalised before it is modulated, as Perez et al. 2018 do: among the
    numbers of one sample, normalising after would undo much of the modulation. It is by 1 + γ
    rather than γ.

    Attributes:
      action_space: what the policy chooses from.
      channels: of every convolution, and features of the view.
      groups: of the normalisation; divides `channels`.
      blocks: modulated ones.
      instruction_size: features of a word, embedded and read.
      memory_size: units of the LSTM.
      hidden: units of the hidden layer of actor and critic.
      vocabulary: number of tokens, padding included.
      auxiliary_actor: whether there is a second actor, as in `ActorCritic`.
      image: name of the grid observation.
      mission: name of the instruction's tokens.
    """

    action_space: Space
    channels: int = 128
    groups: int = 16
    blocks: int = 2
    instruction_size: int = 256
    memory_size: int = 2048
    hidden: int = 64
    vocabulary: int = 64
    auxiliary_actor: bool = False
    image: str = "image"
    mission: str = "mission"

    @nn.compact
    def __call__(
        self,
        observation: Mapping[str, jax.Array],
        memory: Memory,
        previous_action: Any,
        is_first: jax.Array,
    ) -> tuple[ActorCriticOutput, Memory]:
        """Runs one step or a whole sequence.

        Args:
          observation: codes [B, W, H, C] and tokens [B, L], or time-major [T, B, ...].
          memory: as `initial_memory` returns it, before the first step.
          previous_action: not read.
          is_first: bool [B] or [T, B], true where an episode begins.

        Returns:
          Policy and value, [B] or [T, B], and the memory after the last step. The extras have the
          view's "embedding" and the "belief" that the heads see, float32 [..., F], and the
          "attention" to each word, float32 [..., L].
        """
        del previous_action
        check_one_agent(self, self.action_space)
        image, tokens = observation[self.image], observation[self.mission]
        words = BidirectionalWords(self.instruction_size, self.vocabulary)(tokens)
        flat = image.astype(jnp.float32).reshape((-1, *image.shape[-3:]))
        features = _Block(self.channels, self.groups)(_Stem(self.channels, self.groups)(flat))
        features = features.reshape((*is_first.shape, *features.shape[1:]))

        step: Any = _Step
        if is_first.ndim == 2:
            step = nn.scan(_Step, variable_broadcast="params", split_rngs={"params": False})
        step = step(self.groups, self.blocks, self.memory_size, name="step")
        memory, (embedding, belief, attention) = step(memory, (features, words, tokens, is_first))

        actor = ActorHead(self.action_space, name="actor")
        critic = nn.Dense(1, kernel_init=nn.initializers.orthogonal(1.0), name="critic")
        extras: dict[str, Any] = {
            "embedding": embedding,
            "belief": belief,
            "attention": attention,
        }
        if self.auxiliary_actor:
            auxiliary = ActorHead(self.action_space, name="auxiliary_actor")
            extras["auxiliary_distribution"] = auxiliary(self._layer(belief, "auxiliary"))
        distribution = actor(self._layer(belief, "actor"))
        value = critic(self._layer(belief, "critic"))[..., 0]
        return ActorCriticOutput(distribution, value, extras), memory

    def _layer(self, belief: jax.Array, name: str) -> jax.Array:
        return nn.tanh(nn.Dense(self.hidden, kernel_init=RELU, name=f"{name}_hidden")(belief))

    @nn.nowrap
    def initial_memory(self, lanes: int) -> Memory:
        """Returns the memory of `lanes` lanes that have seen nothing."""
        return LSTM(self.memory_size).initial(lanes)


class _Stem(nn.Module):
    """From codes [N, W, H, C], as numbers, to a map of features a quarter as wide and high."""

    channels: int
    groups: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for size in (2, 3):
            x = Convolution(self.channels, size, padding=1)(x)
            x = _pooled(nn.relu(nn.GroupNorm(self.groups)(x)))
        return x


def _pooled(x: jax.Array) -> jax.Array:
    """Returns the maxima of 2 × 2 places, [N, W // 2, H // 2, C].

    As maxima of two at a time: of a reduction to the maximum, XLA may compute the operand once more
    for the gradient and round it otherwise; then no place has the maximum, and the gradient is NaN.
    """
    w, h = (side // 2 * 2 for side in x.shape[1:3])
    places = itertools.product((0, 1), repeat=2)
    return functools.reduce(jnp.maximum, [x[:, i:w:2, j:h:2] for i, j in places])


class _Block(nn.Module):
    """Two convolutions, to be modulated: [N, W, H, C] to the same."""

    channels: int
    groups: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        x = nn.relu(nn.GroupNorm(self.groups)(Convolution(self.channels, 3, padding=1)(x)))
        return nn.GroupNorm(self.groups)(Convolution(self.channels, 3, padding=1)(x))


class _Step(nn.Module):
    """What depends on the memory, for one step of all lanes."""

    groups: int
    blocks: int
    memory_size: int

    @nn.compact
    def __call__(
        self, memory: Memory, inputs: tuple[jax.Array, jax.Array, jax.Array, jax.Array]
    ) -> tuple[Memory, tuple[jax.Array, jax.Array, jax.Array]]:
        """Returns the memory, and the view's features, the LSTM's output and the attention.

        Args:
          memory: before the step; forgotten where an episode begins.
          inputs: the first block's map before it is modulated, [B, w, h, C]; words [B, L, F];
            tokens [B, L]; is_first [B].
        """
        x, words, tokens, is_first = inputs
        remembered = jnp.where(is_first[:, None], 0.0, jnp.concatenate(memory, axis=-1))
        query = nn.Dense(words.shape[-1], name="query")(remembered)
        instruction, attention = attend(query, words, tokens)
        for index in range(self.blocks):
            if index:
                x = _Block(x.shape[-1], self.groups)(x)
            x = nn.relu(FiLM()(x, instruction))
        embedding = _pooled(x).reshape((x.shape[0], -1))
        belief, memory = LSTM(self.memory_size, name="lstm")(embedding, memory, is_first)
        return memory, (embedding, belief, attention)
