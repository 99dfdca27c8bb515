"""The command beside a row makes that row, whatever was set."""

from dataclasses import replace

from mrsan import Crowd, Reward, Scenario, Split
from samarl.commands.bench import _command
from samarl.evaluation.runner import Evaluation


def test_the_command_names_all_that_is_not_as_by_default() -> None:
    column = Scenario(fov_degrees=90.0, humans=4, robots=2)
    plain = "samarl-evaluate agent=orca scenario.fov_degrees=90 scenario.humans=4 scenario.robots=2"
    assert _command("orca", column, Evaluation()) == plain
    assert _command("orca", column, Evaluation(batch=7)) == plain  # does not change the result
    scenario = replace(column, crowd=Crowd.still, occlusion=True, reward=Reward(arrival=3.0))
    evaluation = Evaluation(split=Split.validation, first_case=7, cases=9)
    assert _command("orca", scenario, evaluation) == plain + (
        " scenario.occlusion=True scenario.crowd=still scenario.reward.arrival=3.0"
        " evaluation.split=validation evaluation.first_case=7 evaluation.cases=9"
    )
