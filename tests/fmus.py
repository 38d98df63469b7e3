"""FMUs in tests: FMPy's calls of both versions under one name."""

import math

import numpy as np
import pytest

from adaptrack.core import library
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.world import World

needed = pytest.mark.skipif(library.WAY != "library", reason="compares libraries")


class Instance:
    """An instance of an FMU, driven by FMPy's calls."""

    def __init__(self, path, folder, name="one", **parameters):
        fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
        self.description = fmpy.read_model_description(str(path))
        self.second = self.description.fmiVersion == "2.0"
        slave = fmpy.fmi2.FMU2Slave if self.second else fmpy.fmi3.FMU3Slave
        unpacked = folder / path.stem
        if not unpacked.exists():
            fmpy.extract(str(path), str(unpacked))
        self.fmu = slave(
            guid=self.description.guid, unzipDirectory=str(unpacked),
            modelIdentifier=self.description.coSimulation.modelIdentifier, instanceName=name,
        )  # fmt: skip
        self.variables = {variable.name: variable for variable in self.description.modelVariables}
        self.fmu.instantiate()
        self.begin(**parameters)

    def begin(self, start=0.0, **parameters):
        if self.second:
            self.fmu.setupExperiment(startTime=start)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start)
        self.set(**parameters)
        self.fmu.exitInitializationMode()
        self.period, self.start, self.steps = self.get("period"), start, 0

    def set(self, **values):
        for name, value in values.items():
            variable = self.variables[name]
            getattr(self.fmu, f"set{variable.type}")([variable.valueReference], [value])

    def get(self, *names):
        values = [
            getattr(self.fmu, f"get{self.variables[n].type}")([self.variables[n].valueReference])[0] for n in names
        ]
        return values if len(names) > 1 else values[0]

    def get_array(self, name, length):
        """The numbers of an array; in FMI 2.0 each is a variable."""
        if self.second:
            return [self.get(f"{name}[{i + 1}]") for i in range(length)]
        return self.fmu.getFloat64([self.variables[name].valueReference], nValues=length)

    def set_array(self, name, numbers):
        """Set the numbers of an array."""
        if self.second:
            first = self.variables[f"{name}[1]"].valueReference
            self.fmu.setReal(list(range(first, first + len(numbers))), numbers)
        else:
            self.fmu.setFloat64([self.variables[name].valueReference], numbers)

    def step(self, periods=1, **values):
        self.set(**values)
        at = self.start + self.steps * self.period
        self.fmu.doStep(currentCommunicationPoint=at, communicationStepSize=periods * self.period)
        self.steps += periods

    def saved(self):
        if self.second:
            return self.fmu.serializeFMUstate(self.fmu.getFMUstate())
        return self.fmu.serializeFMUState(self.fmu.getFMUState())

    def restore(self, state):
        if self.second:
            self.fmu.setFMUstate(self.fmu.deSerializeFMUstate(state))
        else:
            self.fmu.setFMUState(self.fmu.deserializeFMUState(state))

    def free(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


class Signals:
    """What a drive of `simulate` gives a car at its instants, as inputs of the FMU."""

    def __init__(self, plant, controller, route, profile, driver):
        self.world = World.of(plant, controller, profile, driver, None, None)
        self.route, self.driver = route, driver
        self.signals = route.sample(controller.period)
        self.curved = hasattr(route, "road")

    def loop(self, seed):
        return ClosedLoop(self.world, self.route, seed)

    def at(self, k, station):
        signals, n = self.signals, self.signals.n
        place, inputs = k, {}
        if self.curved:
            place = max(int(np.searchsorted(signals.station, station, side="right")) - 1, 0)
            inputs = {"on_plan": True, "plan_station": signals.station[k]}
        ahead = signals.speed[k + 1]
        if self.driver is not None:
            periods = self.driver.preview / self.world.period
            j = min(k + math.floor(periods), n)
            near, beyond = signals.speed[j], signals.speed[min(j + 1, n)]
            ahead = near + (periods - math.floor(periods)) * (beyond - near)
        wheels = ("front_left", "front_right", "rear_left", "rear_right")
        inputs |= {f"friction_{wheel}": value for wheel, value in zip(wheels, signals.friction[place], strict=True)}
        wind_x, wind_y = signals.wind[place]
        return inputs | {
            "speed": signals.speed[k], "speed_ahead": ahead, "wind_x": wind_x, "wind_y": wind_y,
            "bank": signals.bank_acceleration[place], "grade": signals.grade[place],
        }  # fmt: skip
