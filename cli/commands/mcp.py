"""`locfuse mcp`: tools for an agent, by the Model Context Protocol over standard input and output."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mcp.server.mcpserver import MCPServer

INSTRUCTIONS = (
    "locfuse tells what each sensor of a wheeled robot is worth, from recorded logs: info() lists the logs, "
    "info(log) says what is in one, compare(log) which sensors to keep and what is set wrong. Findings have "
    "fixes: pass them as settings, {'table.key': value}, and compare again. Read the headline first; figures of a "
    "log with void or doubtful entries must not be used."
)
FOLDER = click.Path(path_type=Path, file_okay=False, exists=True)


@click.command()
@click.argument("folders", nargs=-1, required=True, type=FOLDER)
@click.option(
    "-o",
    "--out",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="The folder that results are written to.",
)
def mcp(folders: tuple[Path, ...], out: Path) -> None:
    """Serve an agent: tools on the logs below FOLDERS, by the Model Context Protocol (stdin, stdout).

    It reads nothing outside FOLDERS and writes only below -o. An agent's program starts this command itself.

    \b
    pip install 'locfuse[mcp]'
    locfuse mcp bags/ -o results/
    """
    from locfuse.cli.session.agent_tools import Tools

    served(Tools(folders, out)).run("stdio")


def served(tools: Any) -> MCPServer:
    """Return the server of these tools. Raises ModuleNotFoundError if the SDK is not installed."""
    from functools import wraps
    from threading import Lock

    from mcp.server.mcpserver import MCPServer
    from mcp.server.mcpserver.exceptions import ToolError

    from locfuse.cli.analysis.errors import expected
    from locfuse.cli.session.agent_tools import spoken
    from locfuse.formats.versions import own

    server = MCPServer("locfuse", instructions=INSTRUCTIONS, version=own(), log_level="ERROR")
    lock = Lock()

    def one_at_a_time(tool: Any) -> Any:
        """Return a tool that handles one call at a time, with errors of one line."""

        @wraps(tool)
        def call(*args: Any, **keywords: Any) -> Any:
            try:
                with lock:
                    return spoken(tool(*args, **keywords))
            except Exception as problem:
                known = expected(problem)
                if known is None:
                    raise
                raise ToolError(spoken(known[0])) from None

        return call

    for name in ("info", "compare", "tune", "calibrate", "explain"):
        server.add_tool(one_at_a_time(getattr(tools, name)))
    return server
