"""The face model of a mouth, and the contract that every synthesiser of its motion keeps."""
