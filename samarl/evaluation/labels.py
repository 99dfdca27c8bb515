"""Names of methods in tables and figures; `agent=` selects them by their names in `conf/agent/`."""

from __future__ import annotations

from collections.abc import Sequence

from samarl.evaluation.summary import Row

_LABELS = {
    "ablation_cross_modal": "SAMARL-Transformer without cross-modal attention, no shield",
    "ablation_graph": "SAMARL-Transformer without graph convolution, no shield",
    "ablation_history": "SAMARL-Transformer without history, no shield",
    "ablation_local_critics": "SAMARL-Transformer with local critics, no shield",
    "ablation_one_block": "SAMARL-Transformer with one block, no shield",
    "cadrl": "CADRL",
    "masac": "MASAC",
    "mlga2c": "MLGA2C",
    "model_predictive": "Motion-primitive planner",
    "model_predictive_recurrent": "Motion-primitive planner, learned prediction",
    "msa3c": "MSA3C",
    "msa3c_one_frame": "MSA3C without TSG",
    "msa3cpred": "MSA3CPred",
    "msa3cpred_concatenation": "MSA3CPred, concatenating critics",
    "msa3cpred_f5": "MSA3CPred, 5 m",
    "msa3cpred_transfer": "MSA3CPred, tracked",
    "orca": "ORCA",
    "perimeter": "Around the crowd",
    "samarl": "SAMARL",
    "samarl_10p3r": "SAMARL-10p3r",
    "samarl_first_waypoint": "SAMARL, first waypoint",
    "samarl_flat": "One level",
    "samarl_general": "SAMARL-General",
    "samarl_lookahead": "SAMARL-Lookahead",
    "samarl_places": "SAMARL-Places",
    "samarl_places_flat": "SAMARL-Places, one level",
    "samarl_planned": "SAMARL-Planned",
    "samarl_ppo": "SAMARL-PPO",
    "samarl_random_waypoints": "SAMARL, random waypoints",
    "samarl_recorded": "SAMARL-Recorded",
    "samarl_shuffled_waypoints": "SAMARL, shuffled waypoints",
    "samarl_srnn": "SAMARL-SRNN",
    "samarl_transfer": "SAMARL, tracked",
    "samarl_transformer": "SAMARL-Transformer",
    "sarl": "SARL",
    "social_force": "Social force",
    "social_force_places": "Social force for places",
    "straight": "Straight",
}
_SHIELD = {"_unshielded": ", no shield", "_shielded": ", shielded"}


def label_of(method: str) -> str:
    """Return the name of a method for readers; that of a custom agent is its own."""
    for ending, words in _SHIELD.items():
        if method.endswith(ending):
            return label_of(method.removesuffix(ending)) + words
    return _LABELS.get(method, method)


def labelled(rows: Sequence[Row]) -> list[Row]:
    """Return rows whose methods have their labels as names."""
    return [row | {"method": label_of(row["method"])} for row in rows]
