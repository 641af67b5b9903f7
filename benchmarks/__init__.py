"""Benchmarks of speed and accuracy. They print tables and assert nothing about time."""

from probedesign.cli.main import use_one_blas_thread

use_one_blas_thread()  # the command line does the same
