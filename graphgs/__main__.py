"""python -m graphgs: the command line."""

from graphgs.cli import main

main()
