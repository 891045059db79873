"""Colours of figures, distinct with any colour vision (Okabe and Ito)."""

BLUE, ORANGE, GREY, GREEN, RED = "#0072B2", "#E69F00", "#999999", "#009E73", "#D55E00"
