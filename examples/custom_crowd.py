"""Evaluate agents in a custom crowd: `python examples/custom_crowd.py`.

The crowd is that of a station: people of different size, slow and fast, who push rather than plan.
Every field of `mrsan.Scenario` can be changed in this way. The values are checked, and the cases
are as reproducible as those of the tables. `mrsan.register_crowd` adds other models of how people
move (docs/extending.md, "A crowd model").
"""

from __future__ import annotations

import argparse

import samarl
from mrsan import Crowd, Scenario

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
    parser.add_argument("--output", default="outputs/station.png")
    arguments = parser.parse_args()
    rows = {name: samarl.evaluate(name, STATION, arguments.cases).row for name in arguments.agents}
    for name, row in rows.items():
        print(f"{name:18} success {row['success_rate']} %, social score {row['social_score']}")
    best = max(rows, key=lambda name: rows[name]["success_rate"])
    print(f"written to {samarl.render(best, STATION, output=arguments.output)}")


if __name__ == "__main__":
    main()
