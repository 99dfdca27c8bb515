"""Networks of the macro level, and their files."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from mrsan import ConfigurationError
from samarl.files import write_json
from samarl.planning.passage_features import MATE, OWN, TOLD
from samarl.policies.card import FORMAT, PolicyCard, find_policy, read_card
from samarl.policies.checkpoint import attribute_errors_to, check_finite, write_tensors

MACRO_LEVEL = "macro_level"  # `PolicyCard.policy` of these files
CHOICES = 2  # QUEUE and ENTER
_MATES = 3.0  # scale of the sum over team-mates


@dataclass
class NetworkConfig:
    """Size and inputs of a macro level."""

    hidden: int = 64  # hidden units
    priorities: bool = True  # it knows the priorities
    intents: bool = True  # it knows the macro actions that team-mates tell


class PassageNetwork(nn.Module):
    """Reads a robot's own numbers and those of any number of team-mates."""

    def __init__(self, config: NetworkConfig, mate: int = MATE, outputs: int = CHOICES) -> None:
        """Create the network with `mate` numbers per team-mate."""
        super().__init__()
        self.config, hidden = config, config.hidden
        self.mate = nn.Sequential(
            nn.Linear(OWN + mate, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU()
        )
        self.trunk = nn.Sequential(
            nn.Linear(OWN + 2 * hidden, 2 * hidden),
            nn.ReLU(),
            nn.Linear(2 * hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, outputs),
        )
        last = self.trunk[-1]
        assert isinstance(last, nn.Linear)
        nn.init.orthogonal_(last.weight, 0.01 if outputs > 1 else 1.0)
        nn.init.zeros_(last.bias)

    def forward(self, own: Tensor, mates: Tensor) -> Tensor:
        """Return the outputs [B, O] for own numbers [B, OWN] and those of mates [B, K, F]."""
        own, mates = self._visible(own, mates)
        pairs = torch.cat([own.unsqueeze(1).expand(-1, mates.shape[1], -1), mates], -1)
        each = self.mate(pairs) * mates[..., :1]
        most = each.amax(1) if mates.shape[1] else own.new_zeros(len(own), self.config.hidden)
        output: Tensor = self.trunk(torch.cat([own, each.sum(1) / _MATES, most], -1))
        return output

    def _visible(self, own: Tensor, mates: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs without those that the configuration hides."""
        if not self.config.priorities:
            own, mates = own.clone(), mates.clone()
            own[..., 0] = 0.0
            mates[..., 1:3] = 0.0
        if not self.config.intents:
            mates = mates.clone()
            mates[..., TOLD] = 0.0
        return own, mates


def save_macro_level(path: Path, actor: PassageNetwork, provenance: dict[str, Any]) -> None:
    """Write the weights to `path`, which ends in `.safetensors`, and the card next to it."""
    digest = write_tensors(path, dict(actor.state_dict()), {})
    card = PolicyCard(MACRO_LEVEL, CHOICES, asdict(actor.config), provenance, digest)
    write_json(path.with_suffix(".json"), {"format": FORMAT, **asdict(card)})


def load_macro_level(name: str, field: str) -> PassageNetwork:
    """Read the actor of a trained macro level.

    Args:
        name: a file, the folder of its training, or the name of an included one.
        field: name of the setting, for error messages.

    Raises:
        ConfigurationError: there is no such file, or it holds something else.
    """
    path = find_policy(name, field)
    card = read_card(path)
    if card.policy != MACRO_LEVEL:
        raise ConfigurationError(
            f"{field} is {name!r}, a policy {card.policy}; it must be a macro level"
        )
    with attribute_errors_to(path):
        weights = load_file(path)
        check_finite(path, weights)
        network = PassageNetwork(NetworkConfig(**card.config))
        network.load_state_dict(weights)
    return network
