"""Campaigns against the whole bridge on simulated servos, with an auditor on the wire."""
