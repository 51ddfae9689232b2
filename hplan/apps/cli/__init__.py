"""The `hplan` command: one file for each subcommand (plan, tour, time, certify, execute, orchard, view).

`main` finds the subcommand; `options`, `terminal`, `job_folder` and `finished_job` are what they share. Heavy
imports wait until the arguments are understood. Whatever is asked for wrongly is an `HplanError`, which `terminal`
shows.
"""
