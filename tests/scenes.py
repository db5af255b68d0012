"""What scenes of tests are made of, for tests of every kind."""

from pathlib import Path

DATA = Path(__file__).parents[2] / "shared" / "data"  # real rooms and motions; tests that need them are skipped without
