"""`softcal completion`: completion of commands and options for a shell."""

import argparse

EXAMPLES = """examples:
  softcal completion bash > ~/.local/share/bash-completion/completions/softcal
  softcal completion zsh > ~/.zfunc/_softcal         # with fpath+=~/.zfunc before compinit
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Print a completion script for a shell; put it where the shell looks for it."""
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"))


def run(options: argparse.Namespace) -> None:
    """Print the script."""
    import shtab

    from softcal.app.cli.main import command_parser

    print(shtab.complete(command_parser(), shell=options.shell))
