"""What engines are compared by: levels, energy, reactions, known figures."""
