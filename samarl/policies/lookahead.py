"""One step ahead: the command whose outcome is worth most (CADRL, Chen et al., 2017).

The encoder decides what a state is worth: with the minimum over pairs it is CADRL, with attention
SARL (Chen et al., Crowd-robot interaction, 2019).
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
from samarl.observations.features import frames_of
from samarl.observations.frames import Frames
from samarl.observations.tracker import Tracks
from samarl.planning.one_step import Commands, command_set, predict_outcomes
from samarl.planning.orca import OrcaParameters, orca_actions
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
    empty_features,
)

CHUNK_SIZE = 256  # states that are valued at once: so few stay in a processor's cache
VALUE_SCALE = 10.0  # what is 1 to the networks; SAMARL's rewards add up to some 30


@dataclass
class LookaheadConfig(OrcaParameters, Commands, PolicyConfig):
    """Numbers of the lookahead, and of ORCA, which drives while it is imitated."""

    discount: float = required(0.0, 0.9999, help="discount per step")


@POLICIES.register("lookahead", LookaheadConfig)
class LookaheadPolicy(Policy):
    """Tries every command on constant-velocity predictions; a network values where it leads.

    When it explores it takes random commands with probability `epsilon`, or what ORCA would do
    while `imitating`; both are set by the algorithm.
    """

    epsilon = 0.0
    imitating = False

    def _make_networks(self, encoder: Encoder) -> Networks:
        """An encoder with one feature gives the value itself."""
        example = empty_features(1, 2, 1, torch.device("cpu"))
        if encoder.history or encoder.initial_state(example):
            raise ConfigurationError(
                f"policy.encoder is {self.config.encoder['name']}, which remembers; it must be one "
                "without history or state for policy.name lookahead: no memory of what was only "
                "imagined"
            )
        y, hidden = encoder.features, self.config.hidden
        head = nn.Sequential(nn.Linear(y, hidden), nn.ReLU(), nn.Linear(hidden, 1))
        return Networks(encoder, {LOCAL: nn.Identity() if y == 1 else head})

    def value(self, frames: Frames, rows: Tensor) -> Tensor:
        """The discounted reward that is expected from P states on, [P].

        Args:
            frames: [P, 1, ...] what is known in them.
            rows: [P] of which robots, see `_per_parameter_set`.
        """

        def of_set(net: Networks, i: int, mine: Any) -> Tensor:
            given = frames.of(mine)
            begins = torch.ones_like(given.ego[..., 0], dtype=torch.bool)
            y = net.encoder.read(net.encoder.observe(given, begins, {}), given.ego[:, 0])
            result: Tensor = net.heads[LOCAL](y).squeeze(-1)
            return result

        with self._precision():
            found: Tensor = self._per_parameter_set(rows, of_set)
        return VALUE_SCALE * found.float()

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
        active = np.ones(shape, np.bool_) if active is None else active
        decided = torch.from_numpy(active)
        tracks, features = self._perceive(observation, state, is_init, scenario)
        action = torch.zeros(*shape, self.action_size)
        if explore and self.imitating:
            avoiding = orca_actions(self.config, observation, scenario)
            action[decided] = torch.from_numpy(avoiding)[decided]
        else:
            epsilon = self.epsilon if explore else 0.0
            action[decided] = self._best(tracks, active, scenario, epsilon)
        local = LevelStep(action, torch.zeros(shape), decided)
        step = PolicyStep(action.clamp(-1.0, 1.0), action, {LOCAL: local})
        return Decision(step, tracks, features, None if explore else self._scene(features))

    def _best(
        self, tracks: Tracks, active: NDArray[np.bool_], scenario: Scenario, epsilon: float
    ) -> Tensor:
        """Return the best command [R, A] of the R active robots, or any with chance `epsilon`."""
        commands = command_set(self.config, scenario.kinematics)
        target = self.route(tracks.ego, scenario)
        outcomes = predict_outcomes(tracks, active, target, commands, scenario)
        imagined = frames_of(outcomes.tracks, scenario, self.config.known_origin).to(self.device)
        rows = torch.from_numpy(np.flatnonzero(active)).to(self.device).repeat(len(commands))
        piece = CHUNK_SIZE if self.device.type == "cpu" else max(len(rows), 1)
        parts = zip(imagined.split(piece), rows.split(piece), strict=True)
        worth = torch.cat([self.value(*part) for part in parts]).cpu()
        later = worth.view(outcomes.reward.shape) * ~torch.from_numpy(outcomes.ended)
        score = torch.from_numpy(outcomes.reward) + self.config.discount * later  # [C, R]
        chosen = score.argmax(0)
        if epsilon > 0.0:
            random = torch.randint(len(commands), chosen.shape)
            chosen = torch.where(torch.rand(chosen.shape) < epsilon, random, chosen)
        return torch.from_numpy(commands)[chosen]

    def _scene(self, frames: Frames) -> Any:
        """What the encoders make of the present, [B, ...]."""
        every = torch.arange(len(frames.ego), device=self.device)
        begins = torch.ones_like(frames.ego[..., 0], dtype=torch.bool)
        with self._precision():
            return self._per_parameter_set(
                every, lambda net, i, mine: net.encoder.observe(frames.of(mine), begins[mine], {})
            )
