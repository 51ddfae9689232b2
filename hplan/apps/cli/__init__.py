"""The `hplan` command, one module for each subcommand of `main.COMMANDS`.

`main` selects the subcommand; all subcommands share `options`, `terminal`, `job_folder` and `finished_job`. Heavy
imports wait until the arguments have been parsed. Invalid requests raise an `HplanError`, which `terminal` prints.
"""
