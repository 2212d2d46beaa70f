CREATE TABLE checks (
    camera TEXT NOT NULL,
    calibration TEXT NOT NULL,
    time_ns BIGINT NOT NULL,
    body TEXT NOT NULL,
    PRIMARY KEY (camera, time_ns)
);
CREATE TABLE readings (
    camera TEXT NOT NULL,
    time_ns BIGINT NOT NULL,
    quantity TEXT NOT NULL,
    value DOUBLE PRECISION NOT NULL,
    std_err DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (camera, time_ns, quantity)
);
CREATE TABLE alarms (
    camera TEXT NOT NULL,
    time_ns BIGINT NOT NULL,
    since_ns BIGINT NOT NULL,
    what TEXT NOT NULL,
    sentence TEXT NOT NULL,
    PRIMARY KEY (camera, time_ns, what)
);
