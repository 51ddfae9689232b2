"""Print a shell completion script, generated from the current commands and options."""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import TYPE_CHECKING

from hplan.apps.cli.options import command_parser
from hplan.base.data_files import shipped_scenes

if TYPE_CHECKING:
    from rich.console import Console

_EPILOG = """\
for this shell: source <(hplan completion bash)
for later shells, write it to ~/.local/share/bash-completion/completions/hplan
"""

_BASH = """\
_hplan() {{
    local command="${{COMP_WORDS[1]}}" before="${{COMP_WORDS[COMP_CWORD - 1]}}" words
    case "$command" in {commands}) ;; *) command=plan ;; esac
    case "$command $before" in
{cases}
    esac
    [ "$COMP_CWORD" -eq 1 ] && words="$words {commands}"
    COMPREPLY=($(compgen -W "${{words//|/ }}" -- "${{COMP_WORDS[COMP_CWORD]}}"))
}}
complete -o default -F _hplan hplan
"""


def run(_: argparse.Namespace, console: Console, __: Console) -> int:
    """Print the script; return the exit status."""
    console.file.write(_script())
    return 0


def _script() -> str:
    """Generate the script from the parsers of all subcommands."""
    from hplan.apps.cli.main import COMMANDS

    cases = []
    for command in COMMANDS:
        actions = import_module(f"hplan.apps.cli.{command}").parser(f"hplan {command}")._actions
        chosen = [(word, action.choices) for action in actions for word in action.option_strings or [command]]
        cases += [f'        "{command} {word}") words="{" ".join(choices)}" ;;' for word, choices in chosen if choices]
        words = [option for action in actions for option in action.option_strings]
        words += shipped_scenes() if any(action.dest == "scene" for action in actions) else []
        cases.append(f'        "{command} "*) words="{" ".join(words)}" ;;')
    return _BASH.format(commands="|".join(COMMANDS), cases="\n".join(cases))


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    parser.add_argument("shell", choices=("bash",), help="name of the shell")
    return parser
