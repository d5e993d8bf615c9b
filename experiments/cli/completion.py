"""``place-rsus completion``: what makes a shell complete commands and options."""

import click
from click.shell_completion import get_completion_class

_SHELLS = ("bash", "zsh", "fish")
_COMPLETE_VARIABLE = "_PLACE_RSUS_COMPLETE"


_COMPLETION_EXAMPLES = """\b
Examples:
  eval "$(place-rsus completion bash)"                      in ~/.bashrc
  eval "$(place-rsus completion zsh)"                       in ~/.zshrc
  place-rsus completion fish > ~/.config/fish/completions/place-rsus.fish"""


@click.command(epilog=_COMPLETION_EXAMPLES)
@click.argument("shell", type=click.Choice(_SHELLS))
@click.pass_context
def completion(context: click.Context, *, shell: str) -> None:
    """Print what makes a shell complete commands, options and their words."""
    root = context.find_root()
    script = get_completion_class(shell)
    # Click has all three.
    assert script is not None
    click.echo(script(root.command, {}, "place-rsus", _COMPLETE_VARIABLE).source())
