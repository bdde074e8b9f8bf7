"""python -m fusion_sfdia: the command line."""

from fusion_sfdia.cli.main import main

raise SystemExit(main())
