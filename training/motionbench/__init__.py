"""MotionBenchMaker's problems of the Panda, out of the source archive of a package that carries them."""
