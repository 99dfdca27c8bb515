"""CrowdNav++ and SoNIC: a recurrent attention graph over people and their predicted positions.

Sources: Liu et al., Intention aware robot crowd navigation with attention-based interaction graph
(2023), github.com/Shuijing725/CrowdNav_Prediction_AttnGraph (`selfAttn_merge_srnn`); Yao et al.,
SoNIC (2024), github.com/tasl-lab/SoNIC-Social-Nav.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from conformal import ErrorQuantiles
from numpy.typing import NDArray
from torch import Tensor, nn
from transfer import PREFERRED_SPEED, TIME_STEP, Others, TransferPolicy, others_of

from mrsan import Observation
from mrsan.features import GOAL, HEADING_COS, HEADING_SIN, ORIGIN, RADIUS, VELOCITY
from mrsan.se2 import rotate, unrotate

SLOTS = 20  # people; the attention's temperature depends on it
STEPS = 5  # of the prediction
SENSOR_RANGE = 5.0  # m, between surfaces
NOBODY = 15.0  # all positions of an empty slot, m
HOLONOMIC_HEADING = math.pi / 2  # which holonomic robots keep in their simulator, rad


def world_axes(vectors: Tensor, heading: Tensor) -> Tensor:
    """Rotate vectors [B, ..., 2] from body axes to world axes; headings are (cos, sin), [B, 2]."""
    cos, sin = (h.reshape(-1, *[1] * (vectors.dim() - 2)) for h in heading.unbind(-1))
    return torch.stack(rotate(cos, sin, vectors[..., 0], vectors[..., 1]), -1)


def robot_state(ego: Tensor) -> Tensor:
    """Return the robots' own features [B, 9] from their observations [B, 11].

    These are the velocity, position, radius, goal, preferred speed and heading in the map's axes.
    """
    heading = ego[:, [HEADING_COS, HEADING_SIN]]
    position = -world_axes(ego[:, ORIGIN], heading)
    constants = ego.new_tensor([PREFERRED_SPEED, HOLONOMIC_HEADING]).expand(len(ego), 2)
    return torch.cat(
        [
            world_axes(ego[:, VELOCITY], heading),
            position,
            ego[:, [RADIUS]],
            position + world_axes(ego[:, GOAL], heading),
            constants,
        ],
        -1,
    )


def in_sensor_range(ego: Tensor, others: Others) -> Tensor:
    """Return who is perceived within the range of their sensor, [B, S]."""
    gap = others.position.norm(dim=-1) - others.radius - ego[:, [RADIUS]]
    return others.visible & (gap <= SENSOR_RANGE)


def predicted_positions(ego: Tensor, others: Others) -> Tensor:
    """Return positions now and after 1..5 steps at constant velocity, [B, S, 6, 2] in m.

    They are relative to the robot's present position, in world axes.
    """
    times = TIME_STEP * torch.arange(STEPS + 1.0).unsqueeze(-1)
    body = others.position.unsqueeze(2) + others.velocity.unsqueeze(2) * times
    return world_axes(body, ego[:, [HEADING_COS, HEADING_SIN]])


def nearest(features: Tensor, distance: Tensor, empty: float) -> Tensor:
    """Return the features [B, S, F] of the nearest, sorted by distance [B, S]: [B, 20, F].

    Slots of those at an infinite distance, and slots that are left over, hold `empty`.
    """
    features = torch.where(distance.isinf().unsqueeze(-1), empty, features)
    order = distance.argsort(-1)[:, :SLOTS, None].expand(-1, -1, features.shape[-1])
    sorted_features = features.gather(1, order)
    missing = SLOTS - sorted_features.shape[1]
    return nn.functional.pad(sorted_features, (0, 0, 0, missing), value=empty)


class AttentionGraph(nn.Module):
    """CrowdNav++'s `selfAttn_merge_srnn` in evaluation; names and shapes are those of its files.

    `critic`, `critic_linear`, `human_node_final_linear` and `logstd` are only loaded.
    """

    def __init__(self, edge_features: int, learns_deviation: bool) -> None:
        super().__init__()
        node = {
            "gru": nn.GRU(128, 128),
            "encoder_linear": nn.Linear(256, 64),
            "edge_attention_embed": nn.Linear(256, 64),
            "output_linear": nn.Linear(128, 256),
        }
        attention = {
            "temporal_edge_layer": nn.ModuleList([nn.Linear(256, 64)]),
            "spatial_edge_layer": nn.ModuleList([nn.Linear(256, 64)]),
        }
        self_attention = {
            "embedding_layer": nn.Sequential(
                nn.Linear(edge_features, 128), nn.ReLU(), nn.Linear(128, 512), nn.ReLU()
            ),
            "q_linear": nn.Linear(512, 512),
            "v_linear": nn.Linear(512, 512),
            "k_linear": nn.Linear(512, 512),
            "multihead_attn": nn.MultiheadAttention(512, 8, batch_first=True),
        }
        parts = {
            "humanNodeRNN": nn.ModuleDict(node),
            "attn": nn.ModuleDict(attention),
            "actor": _tanh_layers(),
            "critic": _tanh_layers(),
            "critic_linear": nn.Linear(256, 1),
            "robot_linear": nn.Sequential(nn.Linear(9, 256), nn.ReLU()),
            "human_node_final_linear": nn.Linear(256, 2),
            "spatial_attn": nn.ModuleDict(self_attention),
            "spatial_linear": nn.Sequential(nn.Linear(512, 256), nn.ReLU()),
        }
        self.base = nn.ModuleDict(parts)
        self.dist = nn.ModuleDict({"fc_mean": nn.Linear(256, 2)})
        if learns_deviation:
            self.dist["logstd"] = nn.ParameterDict({"_bias": torch.zeros(2, 1)})

    def forward(
        self, robot: Tensor, edges: Tensor, count: Tensor, hidden: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the mean velocity in world axes [B, 2], and the next hidden state.

        Args:
            robot: [B, 9] see `robot_state`.
            edges: [B, 20, F] features of the people, the nearest first.
            count: [B] how many of them are people; at least 1.
            hidden: [B, 128].
        """
        base = self.base
        robot = base["robot_linear"](robot)
        empty = torch.arange(edges.shape[1]) >= count.unsqueeze(-1)
        people = base["spatial_linear"](self._self_attention(edges, empty))
        attention = base["attn"]
        query = attention["temporal_edge_layer"][0](robot).unsqueeze(1)
        key = attention["spatial_edge_layer"][0](people)
        temperature = edges.shape[1] / math.sqrt(key.shape[-1])
        score = (query * key).sum(-1) * temperature
        weight = score.masked_fill(empty, -1e9).softmax(-1).unsqueeze(-1)
        crowd = (weight * people).sum(1)
        node = base["humanNodeRNN"]
        inputs = [node["encoder_linear"](robot), node["edge_attention_embed"](crowd)]
        _, hidden = node["gru"](torch.cat(inputs, -1).relu()[None], hidden[None])
        output = node["output_linear"](hidden[0])
        return self.dist["fc_mean"](base["actor"](output)), hidden[0]

    def _self_attention(self, edges: Tensor, empty: Tensor) -> Tensor:
        part = self.base["spatial_attn"]
        embedded = part["embedding_layer"](edges)
        names = ("q_linear", "k_linear", "v_linear")
        projected = [part[name](embedded) for name in names]
        attended, _ = part["multihead_attn"](*projected, key_padding_mask=empty, need_weights=False)
        return attended


def _tanh_layers() -> nn.Sequential:
    return nn.Sequential(nn.Linear(256, 256), nn.Tanh(), nn.Linear(256, 256), nn.Tanh())


@dataclass
class CrowdNavPlusPlus(TransferPolicy):
    """CrowdNav++ with constant-velocity predictions, for files trained with holonomic robots."""

    trained_in = "CrowdNav++"

    def __post_init__(self) -> None:
        """Load the weights; see `TransferPolicy`."""
        super().__post_init__()
        self._worlds = -1

    def make_network(self) -> nn.Module:
        """Return CrowdNav++'s network."""
        return AttentionGraph(2 * (STEPS + 1), learns_deviation=True)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the recurrent state of the worlds [E] in which an episode begins."""
        robots = self.scenario.robots
        if len(worlds) != self._worlds:
            self._worlds = len(worlds)
            self._hidden = torch.zeros(len(worlds) * robots, 128)
        self._hidden[torch.from_numpy(worlds).repeat_interleave(robots)] = 0.0

    def velocity(self, observation: Observation) -> Tensor:
        """See `TransferPolicy.velocity`."""
        if len(observation.ego) != self._worlds:
            self.reset(np.ones(len(observation.ego), np.bool_))
        ego, others = torch.from_numpy(observation.ego).flatten(0, 1), others_of(observation)
        detected = in_sensor_range(ego, others)
        edges = self.edges(ego, others, detected)
        count = detected.sum(-1).clamp(1, SLOTS)
        mean, self._hidden = self.network(robot_state(ego), edges, count, self._hidden)
        mean = mean / (mean.norm(dim=-1, keepdim=True) / PREFERRED_SPEED).clamp_min(1.0)
        cos, sin = ego[:, HEADING_COS], ego[:, HEADING_SIN]
        return torch.stack(unrotate(cos, sin, mean[:, 0], mean[:, 1]), -1)

    def edges(self, ego: Tensor, others: Others, detected: Tensor) -> Tensor:
        """Return the features of the nearest people, [B, 20, F].

        Args:
            ego: [B, 11].
            others: [B, S] everybody around.
            detected: [B, S] who is perceived and near enough.
        """
        distance = others.position.norm(dim=-1).masked_fill(~detected, torch.inf)
        positions = predicted_positions(ego, others).flatten(2)
        return nearest(positions, distance, NOBODY)


@dataclass
class SoNIC(CrowdNavPlusPlus):
    """SoNIC: the same network, which also reads conformal quantiles of the prediction errors."""

    trained_in = "SoNIC's simulator"

    def make_network(self) -> nn.Module:
        """Return SoNIC's network."""
        return AttentionGraph(2 * (STEPS + 1) + STEPS, learns_deviation=False)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the memory of the worlds [E] in which an episode begins."""
        if len(worlds) != self._worlds:
            scenario = self.scenario
            slots = scenario.humans + scenario.robots - 1
            self._quantiles = ErrorQuantiles(len(worlds) * scenario.robots, slots, STEPS)
        super().reset(worlds)
        self._quantiles.reset(torch.from_numpy(worlds).repeat_interleave(self.scenario.robots))

    def edges(self, ego: Tensor, others: Others, detected: Tensor) -> Tensor:
        """Return the features of the nearest people, which end with the quantiles of their errors.

        See `CrowdNavPlusPlus.edges`.
        """
        distance = others.position.norm(dim=-1).masked_fill(~detected, torch.inf)
        positions = predicted_positions(ego, others)
        robot = -world_axes(ego[:, ORIGIN], ego[:, [HEADING_COS, HEADING_SIN]])
        quantile = self._quantiles.update(positions + robot[:, None, None], detected)
        return torch.cat(
            [nearest(positions.flatten(2), distance, NOBODY), nearest(quantile, distance, 0.0)], -1
        )
