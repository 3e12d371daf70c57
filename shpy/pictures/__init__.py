"""Pictures of programs and chains: filled inputs, pixels of outputs, animations, and the files they go to."""
