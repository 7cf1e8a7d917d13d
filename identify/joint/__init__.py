"""The joint fit's inside: parameters, responses with exact sensitivities, the least-squares problem and its solver."""
