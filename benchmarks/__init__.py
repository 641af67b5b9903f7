"""How fast the program is beside the other ways to do the same. Not tests: nothing here asserts on time."""

from probedesign.cli.main import use_one_blas_thread

use_one_blas_thread()  # as the command does
