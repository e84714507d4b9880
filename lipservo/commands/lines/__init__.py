"""The commands of `lipservo lines`, which render, perform, align and recognise scripted lines."""
