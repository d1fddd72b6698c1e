"""ADVISOR learns the corridor, both from the expert and from its own steps."""

import dataclasses

import jaxact
from jaxact import Stage
from jaxact.losses import PPO, Advisor
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from tests.corridor import corridor
from tests.tiny import experiment


def test_advisor_learns():
    pomdp = corridor()
    encoder = Concatenated({"vector": Vector((16,))})
    model = ActorCritic(pomdp.action_space, encoder, NoMemory(), auxiliary_actor=True)
    whole = experiment()
    pipeline = dataclasses.replace(
        whole.pipeline,
        stages=(Stage({"advisor": Advisor(reinforcement=PPO(), alpha=4.0)}, 4096),),
        lanes=32,
        learning_rate=1e-2,
    )
    trained = jaxact.train(
        dataclasses.replace(whole, model=model, pipeline=pipeline),
        evaluate_every=0, evaluation_episodes=200, progress=False,
    )  # fmt: skip
    assert trained.evaluation.success.mean() > 0.95
    # The more the policy acts like the expert, the more of the expert is followed.
    weight = trained.metrics["losses/advisor/imitation_weight"]
    assert weight[0] < 0.3 < 0.6 < weight[-1]
