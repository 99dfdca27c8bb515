"""The web server of the playground: one page, and a websocket through which it plays."""

from __future__ import annotations

import asyncio
import json
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from mrsan import ActionError, ConfigurationError, Crowd, Layout, PluginError
from samarl.configuration import available_agents, available_scenarios
from samarl.evaluation.methods import label_of
from samarl.play.session import MessageError, Session
from samarl.report.build import Site

HOST = "127.0.0.1"  # nobody outside of this machine can connect
_NAMES = [HOST, "localhost"]
LONGEST_MESSAGE = 10_000  # bytes
_TOOLS = {
    "move": ("Move", "drag a person, a robot or a goal; click on a robot to select it"),
    "wall": ("Wall", "draw a wall from one point to another"),
    "erase": ("Erase", "click on a wall to erase it"),
    "person": ("Person", "click to add a person, who then walks where the pointer goes"),
    "drive": ("Drive", "drive the selected robot by the arrow keys or WASD"),
}
_REACTIONS = {
    "blind": "people ignore robots",
    "reciprocal": "people avoid robots",
    "mixed": "reactions are mixed",
}
_VIEWS = (60, 90, 120, 180, 270, 360)


def write_page(folder: Path, command: str, agents: Sequence[str]) -> None:
    """Write the page with its scripts and its style.

    Args:
        folder: an empty folder.
        command: shown in the footer.
        agents: those named on the command line; the page offers the included ones as well.
    """
    names = dict.fromkeys([*agents, *available_agents()])
    site = Site(folder, {"index": "Playground"}, command)
    site.write(
        "index.html",
        "play.html",
        agents={name: label_of(name) for name in names},
        scenarios=available_scenarios(),
        layouts=[layout.name for layout in Layout if layout is not Layout.map],
        crowds=list(Crowd),
        reactions=_REACTIONS,
        views=_VIEWS,
        tools=_TOOLS,
    )
    for script in ("drawing.js", "play.js"):
        site.copy_script(script)


def create_app(pages: Path, create_session: Callable[[Path], Session]) -> Starlette:
    """Return the application; each page that is opened has its own session.

    It refuses requests for other hosts and websockets of pages from elsewhere.

    Args:
        pages: the folder of `write_page`.
        create_session: function of an empty folder.
    """

    async def play(socket: WebSocket) -> None:
        if socket.headers.get("origin") != f"http://{socket.headers.get('host')}":
            await socket.close()  # a page of another site: HTTP 403
            return
        await socket.accept()
        with tempfile.TemporaryDirectory(prefix="samarl-play-") as folder:
            try:
                session = await asyncio.to_thread(create_session, Path(folder))
                await socket.send_json({**session.view()})
                while True:
                    text = await socket.receive_text()
                    await socket.send_json(await asyncio.to_thread(answer, session, text))
            except (WebSocketDisconnect, KeyError):  # KeyError: a message in bytes
                return

    return Starlette(
        routes=[
            WebSocketRoute("/socket", play),
            Mount("/", StaticFiles(directory=pages, html=True)),
        ],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=_NAMES, www_redirect=False)],
    )


def answer(session: Session, text: str) -> dict[str, Any]:
    """Return the answer to a message of the page; an error if it is not valid."""
    try:
        message = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        return {"type": "error", "message": f"{text!r:.60} is not JSON"}
    try:
        return session.handle(message)
    except (MessageError, ConfigurationError, ActionError, PluginError) as error:
        return {"type": "error", "message": " ".join(str(error).split())}
    except Exception as error:  # a bug, which ends neither the session nor the server
        traceback.print_exc()
        return {"type": "error", "message": f"internal error: {error!r:.200}"}


def _refuse_constant(name: str) -> None:
    raise ValueError(name)
