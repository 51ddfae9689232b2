"""The `hplan` command: argument parsing, progress, folders of results. One file for each subcommand.

May use every room; nothing imports it.
"""
