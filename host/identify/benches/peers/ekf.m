% The four-state EKF of host/identify/src/ekf in matrix form, for GNU Octave.
% usage: octave-cli ekf.m FOLDER
arguments = argv();
folder = arguments{1};
model = jsondecode(fileread(fullfile(folder, "model.json")));
handle = fopen(fullfile(folder, "data.f64"), "r", "ieee-le");
data = fread(handle, [2, Inf], "double");
fclose(handle);
p = model.p0;
P = [p(1) p(2) p(3) p(4); p(2) p(5) p(6) p(7); p(3) p(6) p(8) p(9); p(4) p(7) p(9) p(10)];
x = model.x0(:);
F = eye(4); F(1, 2) = model.f12;
Q = diag(model.q); R = diag(model.r); I4 = eye(4);
n = columns(data);
tic;
for k = 1:n
  x = F * x;
  P = F * P * F' + Q;
  H = [1 0 0 0; x(3) x(4) x(1) x(2)];
  K = P * H' / (H * P * H' + R);
  x = x + K * (data(:, k) - [x(1); x(1) * x(3) + x(2) * x(4)]);
  P = (I4 - K * H) * P;
end
seconds = toc;
printf("%s\n", jsonencode(struct("seconds", seconds, "samples", n, "x", x', "version", version())));
