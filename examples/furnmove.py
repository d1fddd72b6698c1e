"""FurnMove: two agents carry a television through a room, with three kinds of joint policies.

python -m jaxact.train examples/furnmove.py:sync

A name after the colon is one of `experiments`: "marginal", each agent's own policy; "central", one
policy over all pairs of actions that sees what both see; "sync", a mixture of as many products of
own policies as there are actions. All have CORDIAL, as in "A Cordial Sync" (Jain et al. 2020,
https://arxiv.org/abs/2007.04979), whose rules, rewards, views and number of components these are;
PPO stands in place of A3C, and the models are smaller and talk less.
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, Cordial
from jaxact.models import GRU, AgentsActorCritic, CentralActor, Concatenated, SyncActor, Vector
from jaxact.schedules import Linear

_STEPS = 20_000_000
# To what CORDIAL's weight falls, and in how many steps; there is no entropy bonus beside it.
_LEAST, _FALLS = 0.01, 2_000_000

_POMDP = envs_jax.make("FurnMove-v0")
_ACTIONS = len(_POMDP.environment.action_names)
_ACTORS = {
    "marginal": None,
    "central": CentralActor(_ACTIONS),
    "sync": SyncActor(_ACTIONS, components=_ACTIONS),
}


def _experiment(policy: str) -> Experiment:
    return Experiment(
        name=f"furnmove_{policy}",
        pomdp=_POMDP,
        model=AgentsActorCritic(
            _POMDP.action_space,
            Concatenated({"view": Vector((256, 128), axes=3)}),
            GRU(128),
            identity=True,
            team_actor=_ACTORS[policy],
        ),
        pipeline=TrainingPipeline(
            stages=(
                Stage(
                    losses={"ppo": PPO(entropy=0.0), "cordial": Cordial()},
                    weights={"cordial": Linear(1.0, _LEAST, steps=_FALLS)},
                    steps=_STEPS,
                ),
            ),
            lanes=64,
            rollout_length=64,
            epochs=4,
            minibatches=2,
            learning_rate=Linear(5e-4, 0.0, steps=_STEPS),
        ),
    )


experiments = {policy: _experiment(policy) for policy in _ACTORS}
experiment = experiments["sync"]
