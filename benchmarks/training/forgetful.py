"""A tracking run that forgets, for timing what is tracked."""


class ForgetfulRun:
    run_id = "none"

    def metrics(self, metrics, step):
        pass

    def flush(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        pass


def report_nothing(metrics, *, finished):
    del metrics, finished
