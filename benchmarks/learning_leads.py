"""Measure ideas for faster learning, each alone: `python -m benchmarks.learning_leads`.

Every idea changes one thing of `samarl-train policy=flat trainer.steps=600000` and is trained with
several seeds, one after another, in one process of one thread. It is validated without the shield
on 200 cases among ten people at a view of 360 degrees. Interrupted runs are resumed: the folder
keeps them. A training imports the classes below with `plugins=[benchmarks.learning_leads]`.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from benchmarks.learning_speed import Suite, measure
from benchmarks.mirror_images import TURNED, mirrored
from samarl.algorithms import ALGORITHMS
from samarl.algorithms.critics import CriticEncoder
from samarl.algorithms.mappo import MAPPO, MAPPOConfig
from samarl.algorithms.on_policy import OnPolicyConfig, Statistics, selected_decisions
from samarl.algorithms.reppo import CategoricalValue
from samarl.algorithms.training_data import TrainingData
from samarl.encoders import ENCODERS
from samarl.encoders.encoder import EncoderState
from samarl.encoders.gru import unroll
from samarl.encoders.set_pool import SetPoolConfig, SetPoolEncoder
from samarl.observations.frames import FeatureSizes, Frames
from samarl.policies.policy import LOCAL, Policy

STEPS = 600_000
IDEAS = {
    "default": [],
    "mirror images": ["algorithm.name=mirrored"],
    "Muon": ["algorithm.name=muon"],
    "Muon, learning rate 0.001": ["algorithm.name=muon", "algorithm.learning_rate=0.001"],
    "categorical critic": ["algorithm.name=categorical"],
    "relative advantage filter": ["algorithm.name=relative_filter"],
    "late decay of the learning rate": ["algorithm.name=late_decay"],
    "residual blocks": ["algorithm.name=residual", "encoder.name=residual"],
    "memory": ["encoder.name=memory"],
    "REPPO": ["algorithm=reppo"],
}
COMMON = [
    "policy=flat",
    "plugins=[benchmarks.learning_leads]",
    "trainer.processes=1",
    "trainer.threads=1",
    "trainer.validation_cases=200",
    "trainer.validate_every=50000",
]


def main() -> None:
    """Measure all ideas."""
    recipes = {name: (settings, STEPS) for name, settings in IDEAS.items()}
    measure(Suite("learning_leads", __doc__ or "", recipes, list(recipes), COMMON, True))


# Mirror images.


@ALGORITHMS.register("mirrored", MAPPOConfig)
class Mirrored(MAPPO):
    """The policy is trained to take the mirrored action in the mirrored state.

    The symmetry loss of Yu, Turk and Liu (Learning symmetric and low-energy locomotion, 2018).
    Rollouts cannot be mirrored instead: their actions are too improbable where a policy prefers
    one side.
    """

    def _policy_loss(
        self, data: TrainingData, statistics: Statistics, divergence: list[float]
    ) -> Tensor:
        mirrored_features = mirrored(data.sequences.features)
        image = data._replace(sequences=data.sequences._replace(features=mirrored_features))
        error = self._means(image) - (self._means(data) * torch.tensor(TURNED)).detach()
        total = super()._policy_loss(data, statistics, divergence)
        return total + error.square().sum(-1).mean()

    def _means(self, data: TrainingData) -> Tensor:
        """Return the mean actions in the selected steps, [Q, 3]."""
        decisions = selected_decisions(self.policy, data)[1][LOCAL]
        return self.policy.distribution(LOCAL, decisions["embedding"], decisions["row"]).mean


# The optimiser Muon for matrices between hidden layers, Adam for the rest.


@ALGORITHMS.register("muon", MAPPOConfig)
class WithMuon(MAPPO):
    """Matrices of hidden layers are updated by Muon (Jordan et al., 2024)."""

    def __init__(self, policy: Policy, config: MAPPOConfig) -> None:
        """See `PPO`."""
        super().__init__(policy, config)
        hidden: list[nn.Parameter] = []
        others: list[nn.Parameter] = []
        for module in (policy, self):
            for parameter in module.parameters():
                is_hidden = parameter.ndim == 2 and min(parameter.shape) >= 32
                (hidden if is_hidden else others).append(parameter)
        rate = config.learning_rate
        self.muon = torch.optim.Muon(
            hidden, lr=rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw"
        )
        self.optimiser = torch.optim.Adam(others, lr=rate, eps=1e-5, fused=True)

    def optimisers(self) -> dict[str, Any]:
        """See `Algorithm.optimisers`."""
        return {"adam": self.optimiser, "muon": self.muon}

    def _descend(self, statistics: Statistics) -> None:
        super()._descend(statistics)
        self.muon.step()
        self.muon.zero_grad(set_to_none=True)


# Critics that predict a histogram of returns.


class CategoricalHead(CategoricalValue):
    """A `CategoricalValue` in place of PPO's value head; its values are those of returns."""

    def forward(self, *features: Tensor) -> Tensor:
        """Return V [..., 1] of features, [..., F] together."""
        return super().forward(torch.cat(features, -1)).unsqueeze(-1)

    def update(self, targets: Tensor) -> None:
        """Do nothing: the categories are fixed."""

    def normalise(self, value: Tensor) -> Tensor:
        """Return the value."""
        return value

    denormalise = normalise


@ALGORITHMS.register("categorical", MAPPOConfig)
class Categorical(MAPPO):
    """The critics have categories (Farebrother et al., Stop regressing, 2024)."""

    def _make_head(self, level: str, inputs: int) -> Any:
        return CategoricalHead(inputs, self.config.critic_features, 101, -30.0, 50.0)

    def _value_loss(self, data: TrainingData, statistics: Statistics) -> Tensor:
        local = data.levels[LOCAL]
        row, step = (data.selected | (local["valued"] & ~local["decides"])).nonzero(as_tuple=True)
        samples: TensorDict = local[row, step]
        valued = samples["valued"]
        features = self.encoder(data.critic_frames.map(lambda x: x[row, step]))[valued]
        head: Any = self.heads[LOCAL]
        loss: Tensor = head.loss(features, samples["value_target"][valued].squeeze(-1))
        statistics["losses/local_critic"].append(float(loss.detach()))
        return self.config.critic_coefficient * loss


# Other rules for what to learn from, and how fast.


@ALGORITHMS.register("relative_filter", MAPPOConfig)
class RelativeFilter(MAPPO):
    """Samples count whose advantage is at least 1 % of the largest, averaged over updates."""

    largest: float | None = None

    def _select(self, batches: list[dict[str, TensorDict]]) -> list[Tensor]:
        size = [batch[LOCAL]["advantage"].squeeze(-1).abs() for batch in batches]
        largest = max(float(part.max()) for part in size)
        self.largest = largest if self.largest is None else 0.75 * self.largest + 0.25 * largest
        return [
            batch[LOCAL]["decides"] & ((part >= 0.01 * self.largest) | batch[LOCAL]["unsafe"])
            for batch, part in zip(batches, size, strict=True)
        ]


@ALGORITHMS.register("late_decay", MAPPOConfig)
class LateDecay(MAPPO):
    """The learning rate is constant for 70 % of the training, and then falls to 0."""

    def _set_learning_rate(self, share: float) -> None:
        super()._set_learning_rate(max(share - 0.7, 0.0) / 0.3)


# Networks.


class Residual(nn.Module):
    """Layer normalisation, two layers and a residual connection; the size changes first."""

    def __init__(self, inputs: int, features: int) -> None:
        """Create the layers."""
        super().__init__()
        self.resize = nn.Linear(inputs, features)
        self.block = nn.Sequential(
            nn.LayerNorm(features),
            nn.Linear(features, 2 * features),
            nn.ReLU(),
            nn.Linear(2 * features, features),
        )
        self.norm = nn.LayerNorm(features)

    def forward(self, x: Tensor) -> Tensor:
        """Return [..., features] of [..., inputs]."""
        x = self.resize(x)
        return torch.relu(self.norm(x + self.block(x)))


def _inputs(layers: Any) -> int:
    """Return the number of inputs of the first of several layers."""
    return int(layers[0].in_features)


@ENCODERS.register("residual", SetPoolConfig)
class ResidualEncoder(SetPoolEncoder):
    """A pooled set whose last layer is a residual block."""

    def __init__(self, config: SetPoolConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        self.out: Any = Residual(_inputs(self.out), config.features)


@ALGORITHMS.register("residual", MAPPOConfig)
class ResidualMAPPO(MAPPO):
    """MAPPO with residual blocks in its critics."""

    def _make_critic_encoder(self, config: OnPolicyConfig) -> CriticEncoder:
        encoder: Any = super()._make_critic_encoder(config)
        encoder.out = Residual(_inputs(encoder.out), config.critic_features)
        return encoder


@ENCODERS.register("memory", SetPoolConfig)
class MemoryEncoder(SetPoolEncoder):
    """A pooled set whose scenes are remembered by a gated recurrent unit."""

    def __init__(self, config: SetPoolConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        scene = _inputs(self.out) - config.width
        self.cell = nn.GRUCell(scene, config.width)
        self.out = nn.Sequential(nn.Linear(scene + 2 * config.width, config.features), nn.ReLU())

    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> Tensor:
        """See `Encoder.observe`; the scene is that of one frame, and the hidden state."""
        scene = super().observe(frames, is_init, state).unflatten(0, is_init.shape)
        hidden = unroll(self.cell, scene, is_init, state["hidden"])
        both = torch.cat([scene, hidden], -1).flatten(0, 1)
        return both if samples is None else both[samples]

    def initial_state(self, frame: Frames) -> EncoderState:
        """Return the hidden state, [B, width]."""
        return {"hidden": frame.ego.new_zeros(len(frame.ego), self.cell.hidden_size)}

    def step(self, frame: Frames, is_init: Tensor, state: EncoderState) -> Tensor:
        """See `Encoder.step`."""
        scene = self.observe(frame, is_init.unsqueeze(1), state)
        state["hidden"][:] = scene[:, -self.cell.hidden_size :]
        return scene


if __name__ == "__main__":
    main()
