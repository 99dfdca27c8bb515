"""`samarl-play`: a playground in the browser."""

from __future__ import annotations

import socket
import tempfile
import webbrowser
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import MISSING, DictConfig

from mrsan import ConfigurationError, Split
from mrsan.cases import CASES_PER_SPLIT
from mrsan.fields import check_numbers, number
from samarl.commands.cli import command_line, run_command
from samarl.configuration import scenario_in


@dataclass
class Play:
    """Schema of `conf/play.yaml`."""

    case: int = number(MISSING, 0, CASES_PER_SPLIT - 1, help="index of the test case")
    port: int = number(MISSING, 0, 65535, help="port of the page on this machine; 0: a free one")
    open_browser: bool = MISSING
    scenario: Any = MISSING
    agents: list[str] = field(default_factory=list)
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(play, "play", play_schema=Play)


def play(config: DictConfig) -> None:
    """Serve the page until the command is interrupted."""
    check_numbers(Play(case=config.case, port=config.port, open_browser=config.open_browser), "")
    agents = list(config.agents)
    if not 1 <= len(agents) <= 2:
        raise ConfigurationError(f"agents is {agents}; it must be a list of one or two names")
    try:
        import uvicorn

        from samarl.play.server import HOST, LONGEST_MESSAGE, create_app, write_page
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"{error.name} is not installed; pip install 'samarl[play]' installs it"
        ) from None
    from samarl.play.session import Session

    scenario, case = scenario_in(config), Split.test.case(config.case)
    name = None if scenario.case_file else HydraConfig.get().runtime.choices.scenario

    def create_session(folder: Path) -> Session:
        return Session(folder, scenario, agents, case, name=name)

    with (
        _listen(HOST, config.port) as server,
        tempfile.TemporaryDirectory(prefix="samarl-play-") as pages,
    ):
        with tempfile.TemporaryDirectory() as folder:
            create_session(Path(folder))  # compiles, and reports errors, before the page opens
        write_page(Path(pages), command_line("samarl-play"), agents)
        address = f"http://{HOST}:{server.getsockname()[1]}"
        print(
            f"playing at {address}, which only this machine can reach; Ctrl-C stops it", flush=True
        )
        if config.open_browser:
            webbrowser.open(address)
        settings = uvicorn.Config(
            create_app(Path(pages), create_session),
            log_level="warning",
            ws_max_size=LONGEST_MESSAGE,
        )
        uvicorn.Server(settings).run(sockets=[server])


def _listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens on a port.

    Raises:
        ConfigurationError: another program uses it, or this user may not.
    """
    try:
        return socket.create_server((host, port))
    except OSError as error:
        raise ConfigurationError(
            f"port is {port}; it must be a free port, or 0 ({error.strerror})"
        ) from None


if __name__ == "__main__":
    main()
