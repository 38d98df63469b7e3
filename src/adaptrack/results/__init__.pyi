"""The public names of results."""

from .drive import Run as Run, write_drive_page as write_drive_page
from .page import write_result as write_result
from .record import DrawnCar as DrawnCar
