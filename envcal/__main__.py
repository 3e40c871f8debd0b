"""`python -m envcal` is `envcal`."""

from envcal.cli import main

main()
