"""Validation of a policy during training."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mrsan import Split, social_score
from samarl.agents.learned import DeployedPolicy
from samarl.evaluation.runner import run_cases
from samarl.policies.policy import Policy
from samarl.training.curriculum import CurriculumStage
from samarl.training.setup import build_guide


def validate(
    policy: Policy, stages: Sequence[CurriculumStage], num_cases: int
) -> tuple[float, dict[str, float]]:
    """Evaluate a policy without exploration in the scenarios with which the training ends.

    All people are present in every case: `scenario.humans_min` does not apply.

    It is copied to the CPU; each scenario has `num_cases` validation cases.

    Returns:
        The success rate averaged over the scenarios, and success rate and social score of each
        scenario by their names in the learning curve.
    """
    policy = copy.deepcopy(policy).cpu().eval()
    cases = Split.validation.case(0) + np.arange(num_cases)
    success_rates: list[float] = []
    row: dict[str, float] = {}
    for stage in stages:
        if stage.end < 1.0:
            continue
        scenario = replace(stage.scenario, humans_min=None)
        name = f"{scenario.fov_degrees:g}_{scenario.humans}h_{scenario.robots}r"
        name += "_team" if scenario.team_tracks else ""
        name += f"_{scenario.layout.name}" if scenario.has_walls else ""
        if f"validation/success_{name}" in row:
            continue
        driver_scenario = replace(stage, scenario=scenario).driver_scenario
        guide = build_guide(stage.guide, scenario)
        agent = DeployedPolicy(policy, driver_scenario, guide=guide)
        episodes = run_cases(agent, scenario, cases, len(cases))
        success_rates.append(float(episodes.success.mean()))
        row[f"validation/success_{name}"] = round(success_rates[-1], 4)
        row[f"validation/social_score_{name}"] = round(float(social_score(episodes).mean()), 2)
    return float(np.mean(success_rates)), row
