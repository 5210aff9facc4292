"""Constants of nature, in the units of this program: km and s."""

G_KM_S2 = 9.80665e-3  # standard gravity
