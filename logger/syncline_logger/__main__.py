"""`python -m syncline_logger` is `syncline`."""

from syncline_logger.cli import main

main()
