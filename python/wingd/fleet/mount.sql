-- Rotation of the camera relative to its ground frame, mrad.
CREATE TABLE rotations AS
SELECT solve, aircraft, wing, recorder_id, flight, series, shot, min(utc) AS utc,
       max(value) FILTER (index = 1) * pi() / 0.18 AS x_mrad, max(value) FILTER (index = 2) * pi() / 0.18 AS y_mrad,
       max(value) FILTER (index = 3) * pi() / 0.18 AS z_mrad,
       sqrt(avg(sigma ** 2)) * pi() / 0.18 AS sigma_mrad
FROM parameters WHERE parameter = 'mount_rotation_deg' AND status = 'ok'
GROUP BY solve, aircraft, wing, recorder_id, flight, series, shot;

-- The scatter of a single frame or flight is null. Within a flight the mounting creeps, between flights it is removed and remounted.
CREATE VIEW mount_by_flight AS
SELECT solve, aircraft, wing, recorder_id, flight, min(utc) AS began, count(*) AS frames,
       avg(x_mrad) AS x_mrad, avg(y_mrad) AS y_mrad, avg(z_mrad) AS z_mrad,
       sqrt(var_samp(x_mrad) + var_samp(y_mrad) + var_samp(z_mrad)) AS within_mrad,
       sqrt(avg(sigma_mrad ** 2)) AS sigma_mrad
FROM rotations GROUP BY ALL;

CREATE VIEW mount_by_aircraft AS
SELECT solve, aircraft, wing, recorder_id, count(*) AS flights, sqrt(avg(within_mrad ** 2)) AS within_mrad,
       sqrt(var_samp(x_mrad) + var_samp(y_mrad) + var_samp(z_mrad)) AS between_mrad, sqrt(avg(sigma_mrad ** 2)) AS sigma_mrad
FROM mount_by_flight GROUP BY ALL;
