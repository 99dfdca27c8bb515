"""`python -m samarl`: the command `samarl`."""

from samarl.main import main

main()
