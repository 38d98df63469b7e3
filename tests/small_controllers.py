"""A controller in Python for tests that look at the loop around it."""

from adaptrack import Controller


class Scripted(Controller):
    """Steer by a function of time (s), whatever is measured; `samples` keeps what is measured, and the speed."""

    name = "scripted"

    def __init__(self, steering, period=0.05):
        self.steering, self.period = steering, period
        self.reset()

    def reset(self):
        self.samples = []

    def step(self, state, speed, reference, variables=None):
        self.samples.append([*state, speed])
        return self.steering((len(self.samples) - 1) * self.period)

    def describe(self):
        return {"period": self.period}
