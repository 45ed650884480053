"""The paper's equations, one function each: numpy in, numpy out, no state.

Source: Carey and Werfel, "Collective Transport of Unconstrained Objects via Implicit Coordination and
Adaptive Compliance". Letters in the bodies are the paper's; where a printed equation is read in a certain way, the
docstring says so. SI units throughout; joint angles in rad.

Symbols used everywhere (n = 7 joints, m = 3 task directions, r = n - m):

    q, qd     joint positions, velocities, (n,) rad, rad/s
    x         task: height of the tool centre, roll and pitch of the hand, (m,) m, rad, rad, in the arm's base frame B
    M, C, g   joint inertia (n, n), Coriolis matrix (n, n) with Mdot - 2 C skew, gravity torque (n,) N m
    J, Jdot   task Jacobian and its rate, (m, n): rows v_z, w_x, w_y of the hand, frame B
    Jbar      J#, the dynamically consistent inverse, (n, m)
    Z, Zbar   null-space basis with J Z = 0, (n, r), and its inverse Z#, (r, n)
"""
