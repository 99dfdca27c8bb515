"""Evaluate agents in a custom crowd: `python examples/custom_crowd.py`.

The crowd is that of a station: people of different size, slow and fast, who push rather than plan.
Every field of `mrsan.Scenario` can be changed in this way. The values are checked, and the cases
are as reproducible as those of the tables. `mrsan.register_crowd` adds other models of how people
move (docs/extending.md, "A crowd model").
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mrsan import Crowd, Scenario, Split
from samarl.agents import build_agent
from samarl.configuration import load_agent_config
from samarl.evaluation.metrics import METRICS
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.evaluation.trajectory import record_episode
from samarl.report.trajectories import save_trajectories

STATION = Scenario(
    robots=3,
    humans=15,
    humans_min=8,  # the number of people of each case is random
    crowd=Crowd.social_force,
    human_radius_min=0.2,
    human_radius_max=0.4,  # m
    human_speed_min=0.6,
    human_speed_max=1.6,  # m/s
    goal_change_interval=8.0,  # s
    arena_radius=10.0,  # m; a round wall for robots
)


def main() -> None:
    """Evaluate several agents on the same test cases and draw a case of the best agent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--agents", nargs="+", default=["orca", "model_predictive", "samarl"])
    parser.add_argument("--output", type=Path, default=Path("outputs/station.png"))
    arguments = parser.parse_args()
    cases = Evaluation(cases=arguments.cases).case_numbers()
    success = {}
    for name in arguments.agents:
        agent = build_agent(load_agent_config(name), STATION)
        episodes = run_cases(agent, STATION, cases, batch=100)
        row: dict[str, float] = {}
        for metric in ("success_rate", "social_score"):
            row |= METRICS[metric].row_fields(episodes)
        success[name] = row["success_rate"]
        print(f"{name:18} success {row['success_rate']} %, social score {row['social_score']}")
    best = max(success, key=success.__getitem__)
    trajectory = record_episode(
        build_agent(load_agent_config(best), STATION), STATION, Split.test.case(0)
    )
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    save_trajectories([(trajectory, f"{best} at the station")], arguments.output)
    print(f"written to {arguments.output}")


if __name__ == "__main__":
    main()
