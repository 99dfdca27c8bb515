"""Record cases for the documentation: `python -m tools.record_session outputs/docs/play`.

The page is the report's viewer of replays: a handful of cases, with agents to switch between.
"""

from __future__ import annotations

import sys
from pathlib import Path

from mrsan import Split
from samarl import load_agent, load_scenario
from samarl.evaluation.trajectory import record_episode
from samarl.report.build import Site, slug
from samarl.report.replays import ReplayFolder

_AGENTS = ("samarl", "orca", "cadrl", "samarl", "right_of_way")
_CASES = (0, 7, 28)


def main(folder: Path) -> None:
    """Write the page and its replays."""
    site = Site(folder, {"replays": "Recorded cases"}, "make docs")
    site.write("replays.html", "replays.html")
    for script in ("drawing.js", "viewer.js"):
        site.copy_script(script)
    scenarios = {
        "open": (load_scenario(), _AGENTS[:3]),
        "doorway": (
            load_scenario(layout="doorway", humans=5, team_messages=True, lidar_rays=36),
            _AGENTS[3:],
        ),
    }
    planned = [
        (slug(f"{name} {place} {case}"), name, scenario, case)
        for place, (scenario, names) in scenarios.items()
        for name in names
        for case in _CASES
    ]
    replays = ReplayFolder(folder / "replays", [key for key, *_ in planned])
    for key, name, scenario, case in planned:
        agent = load_agent(name, scenario)
        trajectory = record_episode(agent, scenario, Split.test.case(case))
        replays.add(key, name, f"test case {case}", trajectory)
    replays.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
