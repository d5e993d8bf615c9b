"""``place-rsus help`` and ``place-rsus completion``: what a terminal offers beside the work."""

import click
from click.shell_completion import get_completion_class

_SHELLS = ("bash", "zsh", "fish")
_COMPLETE_VARIABLE = "_PLACE_RSUS_COMPLETE"


@click.command(
    epilog="""\b
Examples:
  place-rsus help                  the main command
  place-rsus help scene import     one further down"""
)
@click.argument("names", nargs=-1, metavar="[COMMAND]...")
@click.pass_context
def help_command(context: click.Context, *, names: tuple[str, ...]) -> None:
    """Show the help of a command, page by page on a terminal."""
    at = context.find_root()
    command = at.command
    for name in names:
        inner = command.get_command(at, name) if isinstance(command, click.Group) else None
        if inner is None:
            known = sorted(command.commands) if isinstance(command, click.Group) else []
            raise click.UsageError(
                f"help: got '{' '.join(names)}'; expected "
                + (f"one of {', '.join(known)}" if known else f"nothing behind {at.info_name}")
            )
        at = click.Context(inner, parent=at, info_name=name)
        command = inner
    click.echo_via_pager(command.get_help(at) + "\n")


@click.command(
    epilog="""\b
Examples:
  eval "$(place-rsus completion bash)"                      in ~/.bashrc
  eval "$(place-rsus completion zsh)"                       in ~/.zshrc
  place-rsus completion fish > ~/.config/fish/completions/place-rsus.fish"""
)
@click.argument("shell", type=click.Choice(_SHELLS))
@click.pass_context
def completion(context: click.Context, *, shell: str) -> None:
    """Print what makes a shell complete commands, options and their words."""
    root = context.find_root()
    script = get_completion_class(shell)
    assert script is not None  # click has all three
    click.echo(script(root.command, {}, "place-rsus", _COMPLETE_VARIABLE).source())
