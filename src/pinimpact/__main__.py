"""``python -m pinimpact`` is the command ``pinimpact``."""

from .app.cli import main

if __name__ == "__main__":
    main(prog_name="pinimpact")
