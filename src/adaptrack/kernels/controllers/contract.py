"""placeholder"""
from numba import types
from ..abi import ROUTINE, columns, njit, vector
SITUATION = columns("vy", "yaw", "yaw_rate", "y", "speed", "command")
LAW = types.void(vector, vector, vector, vector, vector, vector)
LAW_FUNCTION = types.FunctionType(LAW)
@njit(LAW, **ROUTINE)
def no_law(situation, reference, tuning, parameters, memory, answer):
    """Stands where a law would."""
