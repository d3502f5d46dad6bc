"""`python -m msv2`: the same as the console script `msv2`."""

from msv2.cli.main import run

if __name__ == "__main__":
    run()
