"""MotionBenchMaker's problems of the Panda (Chamzas et al. 2022), as the vamp repository keeps them."""
