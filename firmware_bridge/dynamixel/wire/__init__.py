"""DYNAMIXEL Protocol 2.0 on a half-duplex line: packets, requests, answers, deadlines."""
