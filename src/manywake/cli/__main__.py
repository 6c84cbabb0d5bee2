"""python -m manywake.cli."""

from manywake.cli.main import main

if __name__ == "__main__":
    main()
