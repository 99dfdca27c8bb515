"""One-step lookahead: take the command with the highest predicted value.

The encoder estimates the value of a state: with the minimum over pairs this is CADRL (Chen et al.,
2017), with attention it is SARL (Chen et al., Crowd-robot interaction, 2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mrsan import ConfigurationError, Observation, Scenario
from mrsan.fields import required
from samarl.encoders import Encoder
from samarl.observations.features import empty_frames
from samarl.observations.frames import FeatureSizes, Frames, split
from samarl.observations.route import heading_for_route
from samarl.planning.one_step import Commands, command_set, predict_outcomes
from samarl.planning.orca import OrcaParameters, orca_actions
from samarl.policies.explanation import Explanation
from samarl.policies.policy import (
    LOCAL,
    POLICIES,
    Decision,
    LevelStep,
    Networks,
    Policy,
    PolicyConfig,
    PolicyState,
    PolicyStep,
)

CHUNK_SIZE = 512  # states that are evaluated together; more do not fit into a processor's cache
ORCA = OrcaParameters(  # of `conf/agent/orca.yaml`, which the policy imitates first
    neighbor_distance=10.0, max_neighbors=10, time_horizon=5.0, safety_space=0.5
)
VALUE_SCALE = 10.0  # a network output of 1; the rewards of an episode add up to about 30


@dataclass
class LookaheadConfig(Commands, PolicyConfig):
    """Settings of the lookahead."""

    discount: float = required(0.0, 0.9999, help="discount per step")


@POLICIES.register("lookahead", LookaheadConfig)
class LookaheadPolicy(Policy):
    """Predict the outcome of every command at constant velocity, and evaluate it with a network.

    For exploration it takes random commands with probability `epsilon`, or ORCA's actions while
    `imitating`; the algorithm sets both.
    """

    config: LookaheadConfig
    epsilon = 0.0
    imitating = False

    def __init__(
        self, config: LookaheadConfig, action_size: int, sizes: FeatureSizes | None = None
    ) -> None:
        """See `Policy`; whatever `sizes` is, only people and robots can be predicted."""
        super().__init__(config, action_size)

    def _make_networks(self, encoder: Encoder) -> Networks:
        """Create a value head; an encoder with one feature gives the value itself."""
        example = empty_frames(Scenario(robots=2, humans=1))
        if encoder.history or encoder.initial_state(example):
            raise ConfigurationError(
                f"policy.encoder is {self.config.encoder['name']}, which has a memory; for "
                "policy.name lookahead it must be one without, because predicted states are not "
                "observed"
            )
        y, hidden = encoder.features, self.config.hidden
        head = nn.Sequential(nn.Linear(y, hidden), nn.ReLU(), nn.Linear(hidden, 1))
        return Networks(encoder, {LOCAL: nn.Identity() if y == 1 else head})

    def value(self, frames: Frames, rows: Tensor) -> Tensor:
        """Return the expected discounted reward from P states on, [P].

        Args:
            frames: [P, 1, ...] what is known in them.
            rows: [P] see `_per_parameter_set`.
        """

        def evaluate(net: Networks, i: int, samples: Any) -> Tensor:
            frame = frames.select(samples)
            is_init = torch.ones_like(frame.ego[..., 0], dtype=torch.bool)
            y = net.encoder.read(net.encoder.observe(frame, is_init, {}), frame.ego[:, 0])
            result: Tensor = net.heads[LOCAL](y).squeeze(-1)
            return result

        value: Tensor = self._per_parameter_set(rows, evaluate)
        return VALUE_SCALE * value

    @torch.no_grad()
    def act(
        self,
        observation: Observation,
        state: PolicyState,
        is_init: NDArray[np.bool_],
        scenario: Scenario,
        correlation: float | None = None,
        active: NDArray[np.bool_] | None = None,
    ) -> Decision:
        """See `Policy.act`; any `correlation` means to explore."""
        explore, shape = correlation is not None, observation.ego.shape[:2]
        tracks = self._track(observation, state, is_init, scenario)
        explained, seen = not explore and active is None, tracks
        if active is None:
            active = np.ones(shape, np.bool_)
        elif not explore:
            seen = tracks.of_robots(active)
        features = self.extract_features(seen, scenario)
        decided = torch.from_numpy(active)
        action, value = torch.zeros(*shape, self.action_size), torch.zeros(shape)
        if explore and self.imitating:
            avoiding = orca_actions(ORCA, observation, scenario)
            action[decided] = torch.from_numpy(avoiding)[decided]
        else:
            epsilon = self.epsilon if explore else 0.0
            action[decided], value[decided] = self._best(tracks, active, scenario, epsilon)
        local = LevelStep(action, torch.zeros(shape), decided)
        step = PolicyStep(action.clamp(-1.0, 1.0), action, {LOCAL: local})
        if not explained:
            return Decision(step, tracks, features)
        return Decision(step, tracks, features, self._scene(features), value)

    def explain(self, decision: Decision) -> Explanation:
        """See `Policy.explain`; with the value of the command that was chosen."""
        assert decision.value is not None
        explanation = super().explain(decision) or Explanation()
        return explanation._replace(value=decision.value.numpy())

    def _best(
        self, tracks: Observation, active: NDArray[np.bool_], scenario: Scenario, epsilon: float
    ) -> tuple[Tensor, Tensor]:
        """Return the best command of the R active robots, or any with chance `epsilon`.

        Returns:
            The command [R, A], and its expected discounted reward [R].
        """
        commands = command_set(self.config, scenario.kinematics)
        target = self.route(tracks, scenario)
        tracks = tracks._replace(ego=heading_for_route(tracks))  # outcomes have no route
        outcomes = predict_outcomes(tracks, active, target, commands, scenario)
        imagined = self.extract_features(outcomes.tracks, scenario)
        rows = torch.from_numpy(np.flatnonzero(active)).to(self.device).repeat(len(commands))
        chunk = CHUNK_SIZE if self.device.type == "cpu" else max(len(rows), 1)
        chunks = zip(split(imagined, chunk), rows.split(chunk), strict=True)
        value = torch.cat([self.value(*part) for part in chunks]).cpu()
        later = value.view(outcomes.reward.shape) * ~torch.from_numpy(outcomes.ended)
        score = torch.from_numpy(outcomes.reward) + self.config.discount * later  # [C, R]
        chosen = score.argmax(0)
        if epsilon > 0.0:
            random = torch.randint(len(commands), chosen.shape)
            chosen = torch.where(torch.rand(chosen.shape) < epsilon, random, chosen)
        return torch.from_numpy(commands)[chosen], score.gather(0, chosen[None])[0]

    def _scene(self, frames: Frames) -> Any:
        """Return the scenes of the encoders, [B, ...]."""
        rows = torch.arange(len(frames.ego), device=self.device)
        is_init = torch.ones_like(frames.ego[..., 0], dtype=torch.bool)

        def observe(net: Networks, i: int, samples: Any) -> Any:
            return net.encoder.observe(frames.select(samples), is_init[samples], {})

        return self._per_parameter_set(rows, observe)
