"""The bundled clip that `lipservo run` plays when it is given nothing else."""
