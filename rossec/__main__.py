"""`python -I -m rossec`: the command line, with PYTHONPATH ignored (docs/decisions/0002)."""

from rossec.cli.main import main

if __name__ == "__main__":
    main()
