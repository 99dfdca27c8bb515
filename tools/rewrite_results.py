"""Measure everything in `results/` again (hours): `python -m tools.rewrite_results`.

Only the sweeps are left out (`tools.run_sweeps`). The figures in the documentation are updated.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from tools import update_docs
from tools.process import run

# Two stages, so that two processes have as many worlds each as one process alone has in a stage.
TWO_STAGES = (
    "curriculum.stages=[{worlds: 192, scenario: {humans: 10, robots: 3}},"
    "{worlds: 192, scenario: {humans: 10, robots: 5}}]"
)
TRAINING = ["-m", "benchmarks.training"]
TRANSFORMER = "experiment=transformer"
MANY_WORLDS = [*TRAINING, "--rounds", "2", TRANSFORMER, "trainer.threads=1", TWO_STAGES]
RECIPES: dict[str, list[str]] = {"two_levels": [], "flat": ["policy=flat"]}  # default encoder


def measure_tables(scripts: Path, recordings: str | None) -> None:
    """Evaluate every table and the predictor.

    Args:
        scripts: the folder of the installed commands.
        recordings: a folder of recorded pedestrians; without it the committed rows about recorded
            pedestrians stay as they are.
    """
    bench, predictor = str(scripts / "samarl-bench"), str(scripts / "samarl-predictor")
    setting = [f"recordings={recordings}"] if recordings else []
    run([bench, "seeds=true", "output=results"])
    run([bench, "table=table2", "seeds=true", "output=results"])
    run([bench, "table=ablations", "output=results"])
    run([bench, "table=robustness", "output=results"])
    run([bench, "table=places", "output=results"])
    run([bench, "table=right_of_way", "seeds=true", "output=results"])
    run([bench, "table=passages", "seeds=true", "output=results"])
    run([bench, "table=transfer", "output=results", *(setting or ["merge=true"])])
    run([predictor, "predictor=recurrent", "output=results", *setting])


def measure_speed(scripts: Path) -> None:
    """Run the benchmarks of throughput, latency and training."""
    python = str(scripts / "python")
    run([python, "-m", "benchmarks.throughput", "--cold", *_output("throughput")])
    run([python, "-m", "benchmarks.latency", *_output("latency")])
    run([python, *TRAINING, TRANSFORMER, *_output("training_throughput")])
    run([python, "-m", "benchmarks.places", *_output("places_check")])
    one_thread = os.environ | {"OMP_NUM_THREADS": "1"}
    torchrun = [str(scripts / "torchrun"), "--nproc-per-node", "2", "--no-python"]
    one, two = _output("training_throughput_1_process"), _output("training_throughput_2_processes")
    run([python, *MANY_WORLDS, *one], env=one_thread)
    run([*torchrun, python, *MANY_WORLDS, *two], env=one_thread)
    for recipe, settings in RECIPES.items():
        output = _output(f"training_throughput_{recipe}")
        run([*torchrun, python, *TRAINING, *settings, "trainer.threads=1", *output], env=one_thread)


def _output(name: str) -> list[str]:
    return ["--output", f"results/{name}.json"]


def main() -> None:
    """Rewrite the tables, the speed measurements and the figures in the documentation."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.rewrite_results", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--recordings", help="a folder of recorded pedestrians")
    recordings = parser.parse_args().recordings
    scripts = Path(sys.executable).parent
    measure_tables(scripts, recordings)
    measure_speed(scripts)
    update_docs.main()


if __name__ == "__main__":
    main()
