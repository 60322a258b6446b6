"""The paper's comparison: four columns over one data set, trained by the real job, judged alike."""
