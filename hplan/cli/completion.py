"""The command `hplan completion`: a script that completes subcommands, options and shipped scenes in a shell."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from hplan.base.data_files import shipped_scenes
from hplan.cli.options import CommandParser, command_parser

_DESCRIPTION = "Print a script that completes hplan's words in a shell, from the options that there are today."
_EPILOG = """\
for this shell: source <(hplan completion bash)
for all later ones: hplan completion bash > ~/.local/share/bash-completion/completions/hplan
"""

_BASH = """\
_hplan() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD - 1]}}" words
    local command="${{COMP_WORDS[1]}}"
    case "$command" in {commands}) ;; *) command=plan ;; esac
    case "$command $before" in
{choices}
        *) case "$command" in
{options}
        esac ;;
    esac
    [ "$COMP_CWORD" -eq 1 ] && words="$words {commands_spaced}"
    COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _hplan hplan
"""


def main(argv: Sequence[str] | None = None, *, prog: str = "hplan completion") -> int:
    """Run the command; returns the exit status."""
    parser(prog).parse_args(argv)
    from hplan.cli.main import COMMANDS

    choices, options = [], []
    for command in COMMANDS:
        known = import_module(f"hplan.cli.{command}").parser(f"hplan {command}")
        words = [option for action in known._actions for option in action.option_strings]
        takes_scene = any(action.dest == "scene" for action in known._actions)
        options.append(f'            {command}) words="{" ".join(words + shipped_scenes() * takes_scene)}" ;;')
        for action in known._actions:
            if action.choices is not None:
                of = "|".join(f'"{command} {option}"' for option in action.option_strings or [command])
                choices.append(f'        {of}) words="{" ".join(action.choices)}" ;;')
    sys.stdout.write(
        _BASH.format(
            commands="|".join(COMMANDS),
            commands_spaced=" ".join(COMMANDS),
            choices="\n".join(choices),
            options="\n".join(options),
        )
    )
    return 0


def parser(prog: str) -> CommandParser:
    """The parser of the command's arguments."""
    parser = command_parser(_DESCRIPTION, _EPILOG, prog=prog)
    parser.add_argument("shell", choices=("bash",), help="the shell")
    return parser
