"""The program: puts the street together, from sound to servos.

`connect` and `connect_async` are those of `lipservo_client`: they speak through a face that runs,
here or on another computer.
"""

from lipservo_client import connect as connect
from lipservo_client import connect_async as connect_async
