"""MotionBenchMaker's problems, out of the source archive of a package that carries them."""
