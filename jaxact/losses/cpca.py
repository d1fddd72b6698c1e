"""Contrastive predictive coding of what actions will lead to: CPC|A."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.errors import check_at_least
from jaxact.losses.base import Batch, Loss, Progress
from jaxact.losses.windows import goes_on, later, named_features, uniform
from jaxact.models.actor_critic import flatten_action
from jaxact.models.memory import GRU
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree
from jaxact.spaces import Space


@dataclass(frozen=True, kw_only=True)
class _ActionConditional(Loss):
    """What both forms of CPC|A share: c_{t,k}, the expectation of step t + k.

    A gated recurrent unit starts from the belief at t and reads the embeddings of the actions
    a_t … a_{t+k−1}; c_{t,k} is its state then. Of all steps t and 1 ≤ k ≤ `steps`, those count for
    which t + k is in the window and of the same episode.

    Attributes:
      action_space: of the actions.
      steps: how far ahead is predicted, at most; Ye et al. use 1, 2, 4, 8 and 16.
      belief: name of the belief in the model's extras.
      hidden: size of the hidden layers.
      action_features: size of an action's embedding.
    """

    action_space: Space
    steps: int = 8
    belief: str = "belief"
    hidden: int = 32
    action_features: int = 4

    def __post_init__(self) -> None:
        check_at_least(1, type(self).__name__, steps=self.steps)

    @property
    def least_length(self) -> int:
        """Two: a step and its successor."""
        return 2

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without the belief asked for."""
        named_features(output, self.belief)

    @property
    @abstractmethod
    def _model(self) -> nn.Module:
        """A module (expectations [K, T, B, H], embedding [T, B, F], exchange) -> comparisons."""

    @property
    def _whole(self) -> nn.Module:
        return _Foresight(self._model, self.action_features)

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the parameters of the recurrent unit and of what compares."""
        del observation
        inputs = (
            flatten_action(self.action_space, action),
            named_features(output, self.belief),
            output.extras["embedding"],
        )
        windows = [x[None] for x in inputs]
        return dict(self._whole.init(key, *windows, 1, lambda features: features))

    def _compare(
        self,
        output: ActorCriticOutput,
        batch: Batch,
        variables: dict[str, PyTree],
        exchange: Callable[[jax.Array], jax.Array],
    ) -> tuple[Any, jax.Array]:
        """Returns what the model says of each k and step, and bool [K, T, B], which of them count.

        Args:
          output: of the model.
          batch: of data.
          variables: of the loss.
          exchange: from features of the batch's embeddings to those they are contrasted with.
        """
        # One step at least, for the shapes' sake; none of it counts where there is no later step.
        steps = max(1, min(self.steps, batch.is_first.shape[0] - 1))
        compared = self._whole.apply(
            variables,
            flatten_action(self.action_space, batch.action),
            named_features(output, self.belief),
            output.extras["embedding"],
            steps,
            exchange,
        )
        return compared, jnp.stack([goes_on(batch.is_first, k) for k in range(1, steps + 1)])


@dataclass(frozen=True, kw_only=True)
class CPCA(_ActionConditional):
    """CPC|A with one negative for each positive (Guo et al. 2018, https://arxiv.org/abs/1811.06407;
    Ye et al. 2020, https://arxiv.org/abs/2007.04561).

    Given c_{t,k}, a classifier f is to tell the embedding φ_{t+k} from that of another step:
    −log σ(f(c, φ_{t+k})) − log(1 − σ(f(c, φ′))). The φ′ are the embeddings of the whole batch,
    permuted.
    """

    @property
    def _model(self) -> nn.Module:
        return _Classifier(self.hidden)

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the sum of its parts: positive and negative."""
        del progress

        def permuted(features: jax.Array) -> jax.Array:
            draws = batch.lanes_of_all_devices(uniform(batch))
            everything = batch.lanes_of_all_devices(features)
            flat = everything.reshape(-1, features.shape[-1])[jnp.argsort(draws.reshape(-1))]
            return batch.lanes_of_this_device(flat.reshape(everything.shape))

        (positive, negative), counts = self._compare(output, batch, variables, permuted)
        parts = {
            "positive": batch.mean(jax.nn.softplus(-positive), where=counts),
            "negative": batch.mean(jax.nn.softplus(negative), where=counts),
        }
        return parts["positive"] + parts["negative"], parts


@dataclass(frozen=True, kw_only=True)
class CPCASoftmax(_ActionConditional):
    """CPC|A with all steps of the batch as candidates (van den Oord et al. 2018,
    https://arxiv.org/abs/1807.03748).

    The cross-entropy of which step of the batch is t + k, by the products g(c_{t,k}) · h(φ) with
    two multilayer perceptrons g and h. It takes `steps` × (T B)² numbers.

    Attributes:
      features: size of what g and h return.
    """

    features: int = 128

    @property
    def _model(self) -> nn.Module:
        return _Product(self.hidden, self.features)

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the cross-entropy."""
        del progress
        log_prob, counts = self._compare(output, batch, variables, batch.lanes_of_all_devices)
        cross_entropy = -batch.mean(log_prob, where=counts)
        return cross_entropy, {"cross_entropy": cross_entropy}


class _Foresight(nn.Module):
    """Rolls the recurrent unit over the actions to come, and compares with what came."""

    model: nn.Module
    action_features: int

    @nn.compact
    def __call__(
        self,
        actions: jax.Array,
        belief: jax.Array,
        embedding: jax.Array,
        steps: int,
        exchange: Callable[[jax.Array], jax.Array],
    ) -> Any:
        """Takes actions [T, B, A], beliefs [T, B, H] and embeddings [T, B, F]."""
        size = belief.shape[-1]
        embedded = nn.Dense(self.action_features, use_bias=False, name="actions")(actions)
        ahead = jnp.stack([later(embedded, k) for k in range(steps)])
        ahead = ahead.reshape(steps, -1, self.action_features)
        no_start = jnp.zeros(ahead.shape[:2], bool)
        expected, _ = GRU(size, name="expectation")(ahead, belief.reshape(-1, size), no_start)
        return self.model(expected.reshape(steps, *belief.shape), embedding, exchange)


class _Classifier(nn.Module):
    """A hidden layer on expectation and embedding, and a logit."""

    hidden: int

    @nn.compact
    def __call__(
        self,
        expected: jax.Array,
        embedding: jax.Array,
        exchange: Callable[[jax.Array], jax.Array],
    ) -> tuple[jax.Array, jax.Array]:
        """Returns the logits of the embeddings that came and of others, [K, T, B]."""
        # The sum of two products is the product with both side by side, without the copies.
        of_expected = nn.Dense(self.hidden, name="of_expected")(expected)
        of_embedding = nn.Dense(self.hidden, use_bias=False, name="of_embedding")(embedding)
        logit = nn.Dense(1, name="logit")

        def compare(features: jax.Array) -> jax.Array:
            return logit(nn.relu(of_expected + _ahead(features, expected.shape[0])))[..., 0]

        return compare(of_embedding), compare(exchange(of_embedding))


class _Product(nn.Module):
    """Two multilayer perceptrons, and the product of what they return."""

    hidden: int
    features: int

    @nn.compact
    def __call__(
        self,
        expected: jax.Array,
        embedding: jax.Array,
        exchange: Callable[[jax.Array], jax.Array],
    ) -> jax.Array:
        """Returns the log-probabilities of the embeddings that came, [K, T, B]."""

        def perceptron(name: str, x: jax.Array) -> jax.Array:
            hidden = nn.relu(nn.Dense(self.hidden, name=f"{name}_hidden")(x))
            result: jax.Array = nn.Dense(self.features, name=name)(hidden)
            return result

        of_expected = perceptron("of_expected", expected)
        of_embedding = perceptron("of_embedding", embedding)
        candidates = exchange(of_embedding).reshape(-1, self.features)
        right = jnp.sum(of_expected * _ahead(of_embedding, expected.shape[0]), axis=-1)
        return right - jax.nn.logsumexp(of_expected @ candidates.T, axis=-1)


def _ahead(features: jax.Array, steps: int) -> jax.Array:
    """Returns what is 1 … `steps` later at each step, [K, T, B, F]."""
    return jnp.stack([later(features, k) for k in range(1, steps + 1)])
