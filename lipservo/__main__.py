"""`python -m lipservo`."""

from lipservo.cli import main

main()
